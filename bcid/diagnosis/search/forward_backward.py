"""The search for the effects that a take shows: forward by joint refits, backward, exchanges, and their rivals.

The base model's own simplifications are fitted first (`bcid.effects.corrections`), so that they are not mistaken for
an effect; like every effect they are removed in the end where they gain too little.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

from bcid.diagnosis.limits import SEARCH_LIMITS
from bcid.diagnosis.locate.pushes import estimate_disturbances
from bcid.diagnosis.locate.regression import DisturbanceRegression, regress_disturbances
from bcid.diagnosis.search import refits
from bcid.diagnosis.search.line_search import effects_without_place, refit_from_sizes
from bcid.diagnosis.search.place_search import refine_places
from bcid.diagnosis.search.refits import gain_nats, named_effects, rank_credible_fits, refit_with_effects
from bcid.diagnosis.search.rivals import Alternatives, distinct_rivals, exchange_until_stable, leave_one_out
from bcid.diagnosis.search.screen import CandidateEffect, NullGains, sample_null_gains, screen_effects, simulate_trials
from bcid.effects.corrections import CORRECTIONS
from bcid.effects.table import ENTRIES
from bcid.likelihood.divergence import none_if_diverged
from bcid.likelihood.limits import LIKELIHOOD_LIMITS
from bcid.likelihood.refit import Fit, refit
from bcid.likelihood.score_test import TrialChanges
from bcid.likelihood.take import Take

COMMAND_DELAYS = ("steering_delay", "motor_delay")

# share of their declared sizes from which the corrections are refitted
FIRST_SHARE = 0.1

Report = Callable[[str], None]


@dataclass(frozen=True)
class SearchResult:
    """The fits that a search ends with: the base model, the accepted effects, and what explains nearly as much."""

    base: Fit
    corrected: Fit  # the base model with those of its own simplifications corrected that are certainly wrong
    best: Fit
    leave_one_out: dict[str, Fit]  # by named effect of `best`: the refit without it
    rivals: tuple[Fit, ...]  # each with one named effect of `best` exchanged, best first
    nulls: NullGains  # what chance promises beside the best fit
    p_value: float  # of the best trial beside the corrected base model, if nothing is missing
    trials: TrialChanges  # of the whole vocabulary beside the corrected base model
    promising: tuple[str, ...]  # effects that gain most from their best sizes, where no score test is informative
    proxies: tuple[str, ...] = ()  # effects dropped because they stand in for something without a name
    at_bounds: tuple[str, ...] = ()  # effects dropped because no car has such a size

    def reduce_to(
        self, best: Fit, take: Take, proxies: Sequence[str] = (), at_bounds: Sequence[str] = ()
    ) -> SearchResult:
        """The search with `best`, which holds fewer effects, and rivals by exchanges without the dropped effects."""
        proxies, at_bounds = (*self.proxies, *proxies), (*self.at_bounds, *at_bounds)
        dropped = (*proxies, *at_bounds)
        promising = tuple(n for n in self.promising if n not in dropped)
        found = exchange_until_stable(best, take, self.trials.without(dropped), (self.corrected, self.base), promising)
        return replace(self, **found._asdict(), proxies=proxies, at_bounds=at_bounds)


class _SearchProblem(NamedTuple):
    """What a forward search asks: which effects explain the take beside the corrected base model."""

    base: Fit
    corrected: Fit
    take: Take
    regression: DisturbanceRegression  # of the base model's disturbances
    trials: TrialChanges
    excluded: tuple[str, ...]
    reference_fit: Fit | None


class _SearchState(NamedTuple):
    """How far a forward search has come: the best fit so far, and what its next round starts from."""

    best: Fit
    nulls: NullGains  # what chance promises beside the fit before
    from_sizes: tuple[str, ...]  # effects that the next round refits from their own sizes
    tried: Sequence[Fit] = ()  # the refits that `best` is the first of
    promising: tuple[str, ...] = ()  # the effects that promised most when they were first refitted from their sizes


def search_effects(
    base: Fit, take: Take, regression: DisturbanceRegression, report: Report = lambda text: None,
    excluded: Sequence[str] = (), reference_fit: Fit | None = None,
) -> SearchResult:  # fmt: skip
    """Search the effects that explain a take: forward selection, backward elimination, exchanges of single effects.

    At each step all base and effect parameters are refitted; an effect must raise the penalised log-likelihood by more
    than chance does.  First the base model's own simplifications are corrected.  `regression` says what of the base
    model's disturbances extra-trees can predict; effects with an id in `excluded` are not considered.  The first
    effect is also sought beside `reference_fit`, a reference model at its own parameters, since refitted parameters
    may hide what is missing.  `report` is called with a text in each round.
    """
    report("the base model's own simplifications")
    corrected = _fit_corrections(base, take)
    report("a score test of every effect")
    trials = simulate_trials(corrected, take).without(excluded)
    nulls = sample_null_gains(corrected, take, trials)
    unscreened = take.pushed or corrected.hypothesis.trusted_simulation
    problem = _SearchProblem(base, corrected, take, regression, trials, tuple(excluded), reference_fit)
    state = _SearchState(corrected, nulls, effects_without_place(corrected, excluded) if unscreened else ())
    state = _search_forward(problem, state, report)
    best = state.best if "pose_latency" in excluded else _replace_delays_by_latency(state.best, take)
    best = refine_places(_eliminate_backward(best, take, state.nulls.gate), take)
    found = _find_alternatives(best, problem, state)
    return SearchResult(base, corrected, *found, state.nulls, nulls.p_value, trials, state.promising)


def _search_forward(problem: _SearchProblem, state: _SearchState, report: Report) -> _SearchState:
    """Forward selection: add to `state.best` the effect whose joint refit gains most, until none gains enough.

    It ends also when a gain is below those that effects reach by chance (`NullGains.gate`), or when
    `SEARCH_LIMITS.max_effects` are named (`max_effects_under_pushes` in a take predicted under pushes, disturbances
    fitted to each 0.5 s).
    """
    base, take = problem.base, problem.take
    max_effects = SEARCH_LIMITS.max_effects_under_pushes if take.pushed else SEARCH_LIMITS.max_effects
    while len(named_effects(state.best)) < max_effects:
        best = state.best
        trials = problem.trials.without(best.hypothesis.effects)
        candidates = screen_effects(best, take, trials)
        min_score = max(SEARCH_LIMITS.min_score_nats, SEARCH_LIMITS.min_score_share * candidates[0].score)
        shortlist = [c for c in candidates[: SEARCH_LIMITS.max_candidates] if c.score > min_score]
        report(f"{len(shortlist)} candidates beside {', '.join(best.hypothesis.effects) or 'the base model'}")
        regression = problem.regression
        if best is not base:
            regression = regress_disturbances(estimate_disturbances(best, take), best.car())
        chance = min(state.nulls.gate, SEARCH_LIMITS.plain_gain_nats)
        required = max(SEARCH_LIMITS.min_explained_share * gain_nats(best, base), chance)
        fits, state = _refit_with_one_more(problem, state, shortlist, regression, required)
        if not (fits and _explains_enough(best, fits[0], regression, required)):
            break
        # beside what is missing even a placebo may promise much: where a gain is plain, the gate beside it counts
        nulls = sample_null_gains(fits[0], take, trials)
        if gain_nats(fits[0], best) < min(state.nulls.gate, nulls.gate):
            break
        state = state._replace(best=fits[0], tried=fits, nulls=nulls)
    return state


def _find_alternatives(best: Fit, problem: _SearchProblem, state: _SearchState) -> Alternatives:
    """The best fit, its refits without each named effect, and its rivals: fits with one effect exchanged for another.

    If it names one effect at most and holds what the forward search found, the rivals are the other refits of the
    round in which that effect was chosen.  Otherwise they come from exchanges, repeated until none raises the
    penalised log-likelihood; the best fit met replaces `best`.
    """
    take, known = problem.take, (problem.corrected, problem.base)
    if best.hypothesis.effects == state.best.hypothesis.effects and len(named_effects(best)) < 2:
        return Alternatives(best, leave_one_out(best, known, take), distinct_rivals(best, state.tried))
    return exchange_until_stable(best, take, problem.trials, known, state.promising)


def _explains_enough(best: Fit, more: Fit, regression: DisturbanceRegression, required_nats: float) -> bool:
    """Whether `more`, with one effect more than `best`, gains at least `required_nats` of penalised log-likelihood.

    Where extra-trees can predict the disturbances, it must also gain `SEARCH_LIMITS.min_predictable_share` of the nats
    that their predictions gain on blocks that they have not seen.
    """
    gained = gain_nats(more, best)
    enough = gained >= SEARCH_LIMITS.min_predictable_share * regression.gain_nats
    return gained >= required_nats and (enough or not regression.predictable)


def _refit_with_one_more(
    problem: _SearchProblem, state: _SearchState, shortlist: Sequence[CandidateEffect],
    regression: DisturbanceRegression, required_nats: float,
) -> tuple[list[Fit], _SearchState]:  # fmt: skip
    """Joint refits of the best fit with one effect more, best first, and the state from which the next round starts.

    Effects of the `shortlist` start from the values that the score test found; in the first round such refits start
    from the reference model's own parameters, too.  Effects in `state.from_sizes` start from those multiples of their
    declared sizes that fit best, if they are likely to gain `required_nats` of penalised log-likelihood.
    """
    best, take, sized = state.best, problem.take, state.from_sizes
    fits = refits.refit_candidates(best, take, refits.score_testable_candidates(best, take, shortlist))
    if problem.reference_fit and best is problem.corrected:
        fits += refits.refit_beside_reference(problem.reference_fit, best, take, problem.excluded)
    if sized:
        more, sized = refit_from_sizes(best, take, sized, required_nats)
        fits += more
    again = sized if take.pushed else ()
    fits, other = _widen_refits(problem, state, rank_credible_fits(fits, take), regression, required_nats)
    return fits, state._replace(from_sizes=(*again, *other), promising=state.promising or again)


def _widen_refits(
    problem: _SearchProblem, state: _SearchState, fits: list[Fit], regression: DisturbanceRegression,
    required_nats: float,
) -> tuple[list[Fit], tuple[str, ...]]:  # fmt: skip
    """The refits `fits`, and more from larger sizes where extra-trees predict disturbances that no refit explains.

    In a take predicted under pushes (disturbances fitted to each 0.5 s), once effects are named, all effects without a
    place that were not tried yet are also refitted from the multiples of their declared sizes that fit best.  The
    second value holds the ids of the most promising of these, () if none were tried.
    """
    best, take = state.best, problem.take
    tried = (*problem.excluded, *state.from_sizes) if take.pushed else problem.excluded

    def suffices(nats: float) -> bool:
        """Whether the best refit so far gains so many nats and explains enough."""
        return bool(fits) and _explains_enough(best, fits[0], regression, nats)

    if not regression.predictable or suffices(max(required_nats, state.nulls.gate)):
        return fits, ()
    fits = rank_credible_fits([*fits, *refits.refit_from_large_sizes(best, take, tried)], take)
    if not (take.pushed and named_effects(best)) or suffices(required_nats):
        return fits, ()
    more, promising = refit_from_sizes(best, take, effects_without_place(best, tried), required_nats)
    return rank_credible_fits([*fits, *more], take), promising


def _replace_delays_by_latency(fit: Fit, take: Take) -> Fit:
    """The fit with a pose latency in place of the delays of both commands, if that raises the penalised log-likelihood.

    The latency starts at the mean of the two delays.  A fit without both delays, or with a latency, is returned as is.
    """
    held = fit.hypothesis.effects
    if not set(COMMAND_DELAYS) <= set(named_effects(fit)) or "pose_latency" in held:
        return fit
    tau = 0.5 * sum(fit.effect_estimates()[f"{name}__tau"][0] for name in COMMAND_DELAYS)
    late = refit_with_effects(fit, take, (*(n for n in held if n not in COMMAND_DELAYS), "pose_latency"), [tau])
    return late if late.penalised_log_likelihood > fit.penalised_log_likelihood else fit


def _fit_corrections(base: Fit, take: Take) -> Fit:
    """The base model refitted with those of its own simplifications (CORRECTIONS) corrected that are certainly wrong.

    Kept are corrections with an amplitude many standard errors from zero (`_is_certain`), if together they gain
    `LIKELIHOOD_LIMITS.usual_gate_nats` of penalised log-likelihood; otherwise `base` is returned.
    """
    free = [n for n in CORRECTIONS if n in base.hypothesis.entries and n not in base.hypothesis.assumed]
    sizes = [p.size for n in free for p in base.hypothesis.entries[n].parameters]
    all_free = base.hypothesis.with_effects(*free)
    known = base.hypothesis.effect_values(base.phi).values()
    start = all_free.phi_of(base.car(), [*known, *(FIRST_SHARE * size for size in sizes)])
    quick = none_if_diverged(
        refit, take, all_free, start, base.start, base.scales, refits.QUICK_ITERATIONS, base.tangent
    )
    if quick is None or gain_nats(quick, base) < LIKELIHOOD_LIMITS.usual_gate_nats:
        return base
    full = refits.refit_fully(quick, take)
    kept = tuple(n for n in free if _is_certain(full, n))
    if not kept:
        return base
    corrected = full if len(kept) == len(free) else refit_with_effects(full, take, kept)
    # a refit may end at another, lower maximum
    return corrected if gain_nats(corrected, base) > LIKELIHOOD_LIMITS.usual_gate_nats else base


def _is_certain(fit: Fit, name: str) -> bool:
    """Whether an amplitude of effect `name` is more than `SEARCH_LIMITS.certain_se` standard errors from zero.

    For such an effect (by this Wald test) no refit without it is made to see what it gains.
    """
    estimates = refits.estimates_by_symbol(fit, name)
    amplitudes = (estimates[p.symbol] for p in ENTRIES[name].amplitude_parameters)
    return any(abs(value) > SEARCH_LIMITS.certain_se * se > 0.0 for value, se in amplitudes)


def _eliminate_backward(fit: Fit, take: Take, gate_nats: float) -> Fit:
    """Backward elimination: the fit without effects that gain less than `gate_nats` of penalised log-likelihood.

    An effect's gain is over the joint refit without it, beside all others; the first that gains too little is removed,
    then all are compared again.  Effects of certain size (`_is_certain`) stay untested.
    """
    held = fit.hypothesis.effects
    if len(held) < 2:
        return fit
    for name in held:
        if name in fit.hypothesis.assumed or _is_certain(fit, name):
            continue
        without = refit_with_effects(fit, take, tuple(n for n in held if n != name))
        if gain_nats(fit, without) < gate_nats:
            return _eliminate_backward(without, take, gate_nats)
    return fit
