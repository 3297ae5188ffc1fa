"""The verdict on a search: which effects are named, with which probability, and what is indistinguishable from them."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from bcid.diagnosis.judge.held_out import HeldOutGain, block_length_s, bootstrap_gain, held_out_log_likelihoods
from bcid.diagnosis.judge.proxies import find_proxies
from bcid.diagnosis.limits import JUDGE_LIMITS, PROXY_LIMITS, SEARCH_LIMITS
from bcid.diagnosis.locate.mismatch import RemainingMismatch
from bcid.diagnosis.locate.scan_statistic import FloorCircle
from bcid.diagnosis.search import refits
from bcid.diagnosis.search.forward_backward import COMMAND_DELAYS, SearchResult
from bcid.diagnosis.search.refits import gain_nats, named_effects
from bcid.documents.diagnosis import Verdict
from bcid.effects.table import EFFECTS
from bcid.likelihood.refit import Fit
from bcid.likelihood.take import SEGMENT_S, Take


@dataclass(frozen=True)
class Finding:
    """One effect that is named."""

    effect: str
    twins: tuple[str, ...]  # effects indistinguishable from it, most likely first
    probability: float
    values: dict[str, tuple[float, float]]  # by symbol, with standard errors
    gain_nats: float  # penalised, beside the other effects
    held_out: HeldOutGain


@dataclass(frozen=True)
class Judgement:
    """The named effects of a search, the verdict, and what is left."""

    verdict: Verdict
    findings: tuple[Finding, ...]  # by gain, the largest first
    dropped: tuple[str, ...]  # effects that the search accepted and the gates did not
    unexplained: RemainingMismatch  # beside `fit`
    gate_nats: float  # a gain that chance does not reach
    corrections: HeldOutGain | None  # of the base model's own simplifications, where they stand out
    search: SearchResult  # without what was dropped

    @property
    def fit(self) -> Fit:
        """The fit with the named effects; the corrected base model where there is none."""
        return self.search.best

    @property
    def unexplained_nats(self) -> float:
        """Nats that something more would gain; zero where chance may be all there is."""
        return self.unexplained.gain_nats(self.gate_nats)

    @property
    def more_is_missing(self) -> bool:
        """Whether what is unexplained is worth reporting beside the named effects."""
        gained = sum(f.gain_nats for f in self.findings)
        return self.unexplained_nats > PROXY_LIMITS.min_remainder_share * gained


def judge_search(
    search: SearchResult, take: Take, place: FloorCircle | None = None, unexplained: RemainingMismatch | None = None,
    dropped: tuple[str, ...] = (),
) -> Judgement:  # fmt: skip
    """Judge the effects that a search accepted: drop those that fail a gate, one after another, and give the verdict.

    Gates ask for a gain beyond chance, on held-out blocks too, for a size that matters and lies at no bound, and that
    the effect is no proxy (it would only stand in for something without a name).  Verdicts are "named", "ambiguous"
    (another effect explains as much), "unknown" (something is missing that no effect explains) and "nothing-found".
    `place` is the circle on the floor where disturbances are largest; `unexplained` is what the best fit leaves,
    computed if None; `dropped` holds ids of effects that failed before.
    """
    best, gate = search.best, search.nulls.gate
    unexplained = unexplained or RemainingMismatch.beside(best, take, place)
    findings = _collect_findings(search, take)
    weakest = _weakest_effect(f for f in findings if not _passes_gates(f, search))
    # a refit with fewer effects may have led another to a bound
    bounded = () if weakest else refits.effects_at_bounds(best, take)
    at_bounds = _weakest_effect(f for f in findings if f.effect in bounded)
    proxies = () if weakest or at_bounds else find_proxies(search, take, place, unexplained)
    failed = (*weakest, *at_bounds, *proxies)
    if failed:
        rest = refits.refit_with_effects(best, take, tuple(n for n in best.hypothesis.effects if n not in failed))
        return judge_search(search.reduce_to(rest, take, proxies, at_bounds), take, place, None, (*dropped, *failed))
    verdict: Verdict = "nothing-found"
    if findings:
        verdict = "ambiguous" if any(f.twins for f in findings) else "named"
    elif unexplained.gain_nats(gate) > 0.0 or best.hypothesis.effects != search.base.hypothesis.effects:
        verdict = "unknown"
    corrections = None
    if search.corrected is not search.base:
        corrected, base = (held_out_log_likelihoods(fit, take) for fit in (search.corrected, search.base))
        corrections = bootstrap_gain(corrected, base, take)
    ranked = tuple(sorted(findings, key=lambda f: -f.gain_nats))
    return Judgement(verdict, ranked, dropped, unexplained, gate, corrections, search)


def _weakest_effect(failing: Iterable[Finding]) -> tuple[str, ...]:
    """Id, in a tuple, of the `failing` finding with the smallest gain, which is dropped first; () if none fails."""
    return tuple(f.effect for f in sorted(failing, key=lambda f: f.gain_nats)[:1])


def _collect_findings(search: SearchResult, take: Take) -> list[Finding]:
    """The named effects of the search's best fit, each with values, gain, held-out gain, probability and twins.

    Twins are effects that explain the take as well in its place; gains (nats) are over the refit without the effect.
    """
    best, findings = search.best, list[Finding]()
    if not named_effects(best):
        return findings
    held_out = held_out_log_likelihoods(best, take)
    for name in named_effects(best):
        less = search.leave_one_out[name]
        gain = bootstrap_gain(held_out, held_out_log_likelihoods(less, take), take, best.log_prior - less.log_prior)
        twins, probability = _indistinguishable_effects(best, search, take, name), _finding_probability(search, name)
        values = refits.estimates_by_symbol(best, name)
        findings.append(Finding(name, twins, probability, values, gain_nats(best, less), gain))
    return findings


def _passes_gates(finding: Finding, search: SearchResult) -> bool:
    """Whether a finding gains more than chance, on held-out blocks too, and has a size that matters.

    Its gain must exceed the search's gate, and one amplitude `JUDGE_LIMITS.min_size_share` of its declared size.  The
    held-out gain must exceed the gate for local effects if the effect has a place or time; otherwise its 95 % interval
    must lie above zero, or the gain above `SEARCH_LIMITS.plain_gain_nats`.
    """
    entry, held_out = search.best.hypothesis.entries[finding.effect], finding.held_out
    least = JUDGE_LIMITS.min_size_share
    matters = any(abs(finding.values[p.symbol][0]) > least * p.size for p in entry.amplitude_parameters)
    # the few blocks of a short take scatter
    certain = held_out.ci95[0] > 0.0 or held_out.nats > SEARCH_LIMITS.plain_gain_nats
    gains = held_out.nats > search.nulls.local_gate if entry.place_parameters else certain
    return gains and matters and finding.gain_nats > search.nulls.gate


def _replacing_effect(name: str, best: Fit, rival: Fit) -> str | None:
    """Id of the effect that the `rival` fit holds in place of `name` in `best`; None if they differ in another way."""
    mine, theirs = set(best.hypothesis.effects), set(rival.hypothesis.effects)
    more = [n for n in theirs - mine if n in EFFECTS]
    return more[0] if mine - theirs == {name} and len(more) == 1 else None


def _indistinguishable_effects(best: Fit, search: SearchResult, take: Take, name: str) -> tuple[str, ...]:
    """Ids of the effects that in place of `name` explain the take as well as the best fit does, most likely first.

    `are_indistinguishable` decides of each of the search's rivals.  A latency of the pose (`pose_latency`) always has
    one: the delays of both commands together.
    """
    twins = ["+".join(COMMAND_DELAYS)] if name == "pose_latency" else []
    for rival in search.rivals:
        other = _replacing_effect(name, best, rival)
        if other and other not in twins and are_indistinguishable(best, rival, take):
            twins.append(other)
    return tuple(twins[: JUDGE_LIMITS.max_twins])


def are_indistinguishable(best: Fit, rival: Fit, take: Take) -> bool:
    """Whether two fits explain the take equally well, by their difference of log-likelihood (Vuong's test, 1989).

    The penalised log-likelihood of `rival` must be lower by less than `JUDGE_LIMITS.rival_nats`; or by less than
    `max_rival_nats`, and the log-likelihood by less than `rival_se` standard errors, from the scatter of blocks.
    """
    behind = gain_nats(best, rival)
    if behind < JUDGE_LIMITS.rival_nats:
        return True
    size = max(1, round(block_length_s(take) / SEGMENT_S))
    each = best.per_segment - rival.per_segment
    sums = np.add.reduceat(each, np.arange(0, len(each), size))
    # a take of one block says nothing of its scatter
    if len(sums) < 2:
        return False
    se = float(sums.std(ddof=1)) * np.sqrt(len(sums))
    return bool(float(each.sum()) < JUDGE_LIMITS.rival_se * se and behind < JUDGE_LIMITS.max_rival_nats)


def _finding_probability(search: SearchResult, name: str) -> float:
    """Probability of a named effect against its rivals, no effect and an unknown one: 1 / (1 + sum exp(-nats / T)).

    The sum is over these alternatives (a softmax); nats are how much lower the penalised log-likelihood of each is, for
    the unknown effect a fixed prior.  The temperature T is `JUDGE_LIMITS.probability_temper`.
    """
    best, temper = search.best, JUDGE_LIMITS.probability_temper
    behind = [gain_nats(best, rival) for rival in search.rivals if _replacing_effect(name, best, rival)]
    nothing, unknown = gain_nats(best, search.leave_one_out[name]), JUDGE_LIMITS.unknown_prior_nats * temper
    nats = [*behind, nothing, unknown]
    return float(1.0 / (1.0 + np.sum(np.exp(-np.maximum(nats, 0.0) / temper))))
