"""The verdict on a search: which effects are named, with which probability, and what is indistinguishable from them."""

from dataclasses import dataclass

import numpy as np

from bcid.diagnosis.judge.held_out import HeldOutGain, block_length_s, bootstrap_gain, held_out_log_likelihoods
from bcid.diagnosis.limits import JUDGE_LIMITS
from bcid.diagnosis.search import refits
from bcid.diagnosis.search.corrections import COMMAND_DELAYS
from bcid.diagnosis.search.name_search import Naming
from bcid.diagnosis.search.refits import gain_nats
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
    gain_nats: float  # by which the evidence falls without it, a remainder free to take its place
    held_out: HeldOutGain


@dataclass(frozen=True)
class Judgement:
    """The named effects of a search, and the verdict."""

    verdict: Verdict
    findings: tuple[Finding, ...]  # by gain, the largest first
    corrections: HeldOutGain | None  # of the base model's own simplifications, where they stand out
    unknown: HeldOutGain | None  # of what has no name, where it adds more than chance


def judge_names(naming: Naming, take: Take) -> Judgement:
    """Judge what a search has named: values, gains, probabilities and twins of each name, and the verdict.

    Verdicts are "named", "ambiguous" (another effect explains as much), "unknown" (something is missing that no effect
    explains: a remainder adds more than the gate, or only the base model's simplifications were put right) and
    "nothing-found".
    """
    findings = tuple(sorted(_collect_findings(naming, take), key=lambda f: -f.gain_nats))
    verdict: Verdict = "nothing-found"
    if findings:
        verdict = "ambiguous" if any(f.twins for f in findings) else "named"
    elif naming.unknown_nats > 0.0 or naming.corrected is not naming.base:
        verdict = "unknown"
    corrections = unknown = None
    if naming.corrected is not naming.base:
        corrections = _gain_held_out(naming.corrected, naming.base, take)
    if naming.unknown_nats > 0.0 and naming.rest.fit is not naming.best:
        unknown = _gain_held_out(naming.rest.fit, naming.best, take)
    return Judgement(verdict, findings, corrections, unknown)


def _gain_held_out(better: Fit, worse: Fit, take: Take) -> HeldOutGain:
    """How much likelier one fit makes the held-out blocks than another."""
    return bootstrap_gain(held_out_log_likelihoods(better, take), held_out_log_likelihoods(worse, take), take)


def _collect_findings(naming: Naming, take: Take) -> list[Finding]:
    """The named effects, each with values, gain, held-out gain, probability and twins."""
    best, findings = naming.best, list[Finding]()
    if not naming.gains:
        return findings
    held_out = held_out_log_likelihoods(best, take)
    for name, nats in naming.gains.items():
        less = naming.without[name]
        gain = bootstrap_gain(held_out, held_out_log_likelihoods(less, take), take, best.log_prior - less.log_prior)
        twins, values = _indistinguishable_effects(naming, take, name), refits.estimates_by_symbol(best, name)
        findings.append(Finding(name, twins, _finding_probability(naming, name), values, nats, gain))
    return findings


def _replacing_effect(name: str, best: Fit, rival: Fit) -> str | None:
    """Id of the effect that the `rival` fit holds in place of `name` in `best`; None if they differ in another way."""
    mine, theirs = set(best.hypothesis.effects), set(rival.hypothesis.effects)
    more = [n for n in theirs - mine if n in EFFECTS]
    return more[0] if mine - theirs == {name} and len(more) == 1 else None


def _indistinguishable_effects(naming: Naming, take: Take, name: str) -> tuple[str, ...]:
    """Ids of the effects that in place of `name` explain the take as well as the best fit does, most likely first.

    `are_indistinguishable` decides of each rival.  A latency of the pose (`pose_latency`) always has one: the delays of
    both commands together.
    """
    # where the throttle is a measured speed, when it was logged is the base model's
    delays = [delay for delay in COMMAND_DELAYS if delay in naming.best.hypothesis.entries]
    twins = ["+".join(delays)] if name == "pose_latency" else []
    for rival in naming.rivals:
        other = _replacing_effect(name, naming.best, rival)
        if other and other not in twins and are_indistinguishable(naming.best, rival, take):
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


def _finding_probability(naming: Naming, name: str) -> float:
    """Probability of a named effect against its rivals, and against none or one without a name in its place.

    Each alternative weighs exp(-nats / T), nats being how much less likely the take is with it, and T the temperature
    `JUDGE_LIMITS.probability_temper`, by which the blind test shows that differences are overstated.
    """
    behind = [gain_nats(naming.best, rival) for rival in naming.rivals if _replacing_effect(name, naming.best, rival)]
    nats = np.maximum([*behind, naming.gains[name]], 0.0)
    return float(1.0 / (1.0 + np.sum(np.exp(-nats / JUDGE_LIMITS.probability_temper))))
