"""Names for what a take shows: forward by joint refits, and each judged by what it adds beside a free remainder.

A name counts by the evidence of the take with all names and the remainder, less that without it, where the remainder
may grow into its place.  What the remainder still adds beside all names is unknown.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

from bcid.diagnosis.limits import SEARCH_LIMITS
from bcid.diagnosis.remainder.fit import RemainderFit, basis_for, fit_with_remainder
from bcid.diagnosis.remainder.functions import RemainderBasis
from bcid.diagnosis.search import refits
from bcid.diagnosis.search.forward_backward import _fit_corrections, _replace_delays_by_latency
from bcid.diagnosis.search.place_search import refine_places
from bcid.diagnosis.search.refits import gain_nats, named_effects, rank_credible_fits, refit_with_effects
from bcid.diagnosis.search.screen import NullGains, sample_null_gains, screen_effects, simulate_trials
from bcid.likelihood.refit import Fit
from bcid.likelihood.score_test import TrialChanges
from bcid.likelihood.take import Take

Report = Callable[[str], None]


class Naming(NamedTuple):
    """The names that a take gives, and what has none."""

    base: Fit
    corrected: Fit
    best: Fit  # with the names
    rest: RemainderFit  # what is left beside them
    gains: dict[str, float]  # nats by which each name makes the take likelier beside the remainder
    plain_gains: dict[str, float]  # and without it
    dropped: tuple[tuple[str, float], ...]  # effects that the remainder replaces, with what they add beside it
    nulls: NullGains
    basis: RemainderBasis


def name_effects(base: Fit, take: Take, excluded: Sequence[str] = (), report: Report = lambda text: None) -> Naming:
    """Name the effects that a take shows beside the fitted `base` model, but for those `excluded`."""
    report("the base model's own simplifications")
    corrected = _fit_corrections(base, take)
    basis = basis_for(corrected, take)
    report("a score test of every effect")
    trials = simulate_trials(corrected, take).without(excluded)
    nulls = sample_null_gains(corrected, take, trials)
    fit = _add_names(corrected, take, trials, nulls.gate, excluded, basis, report)
    if "pose_latency" not in excluded:
        fit = _replace_delays_by_latency(fit, take)
    fit = refine_places(fit, take)
    return _keep_names(base, corrected, fit, take, nulls, basis, report)


def _add_names(
    fit: Fit, take: Take, trials: TrialChanges, gate: float, excluded: Sequence[str], basis: RemainderBasis,
    report: Report,
) -> Fit:  # fmt: skip
    """The fit with one effect after another added, that whose refit gains most, while it gains more than the gate."""
    while len(named_effects(fit)) < SEARCH_LIMITS.max_effects_under_pushes:
        candidates = screen_effects(fit, take, trials.without(fit.hypothesis.effects))
        least = max(SEARCH_LIMITS.min_score_nats, SEARCH_LIMITS.min_score_share * candidates[0].score)
        shortlist = [c for c in candidates[: SEARCH_LIMITS.max_candidates] if c.score > least]
        report(f"{len(shortlist)} candidates beside {', '.join(fit.hypothesis.effects) or 'the base model'}")
        fits = rank_credible_fits(refits.refit_candidates(fit, take, shortlist), take)
        # what the base model takes up shows beside no fit of it, but the remainder tells that something is missing
        if not fits or gain_nats(fits[0], fit) < gate:
            if fit_with_remainder(fit, take, basis).nats < gate:
                break
            fits = rank_credible_fits(refits.refit_from_large_sizes(fit, take, excluded), take)
        if not fits or gain_nats(fits[0], fit) < gate:
            break
        fit = fits[0]
    return fit


def _keep_names(
    base: Fit, corrected: Fit, fit: Fit, take: Take, nulls: NullGains, basis: RemainderBasis, report: Report
) -> Naming:
    """The names that add more than the gate beside the remainder; the one that adds least goes first."""
    dropped: list[tuple[str, float]] = []
    while True:
        report("what is left without a name")
        rest, gains, plain = fit_with_remainder(fit, take, basis), {}, {}
        without = {}
        for name in named_effects(fit):
            held = tuple(n for n in fit.hypothesis.effects if n != name)
            without[name] = refit_with_effects(fit, take, held) if held != corrected.hypothesis.effects else corrected
            plain[name] = gain_nats(fit, without[name])
            gains[name] = rest.log_evidence - fit_with_remainder(without[name], take, basis).log_evidence
        weakest = min(gains, key=lambda n: gains[n], default="")
        if not weakest or gains[weakest] > nulls.gate:
            return Naming(base, corrected, fit, rest, gains, plain, tuple(dropped), nulls, basis)
        dropped.append((weakest, gains[weakest]))
        fit = without[weakest]
