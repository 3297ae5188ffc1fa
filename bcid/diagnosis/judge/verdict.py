"""From fits to findings: what is named, with what certainty, and what cannot be told apart."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from bcid.diagnosis.judge.held_out import Gain, block_s, gain, scores
from bcid.diagnosis.judge.proxies import WORTH_TELLING, stand_ins
from bcid.diagnosis.locate.scan_statistic import Circle
from bcid.diagnosis.locate.unexplained import Left
from bcid.diagnosis.search.forward_backward import DELAYS, PLAIN, Search
from bcid.diagnosis.search.refits import RIVAL, incredible, named, refit_with
from bcid.effects.table import EFFECTS
from bcid.likelihood.refit import Fit
from bcid.likelihood.take import SEGMENT_S, Take

Verdict = Literal["nothing-found", "named", "ambiguous", "unknown"]

TELLING = 2.0  # standard errors of the difference between two explanations that tell them apart
MOST_TWINS = 3
RELEVANT_SIZE = 0.05  # of an effect's size, below which it matters to no prediction
TEMPER = 2.0  # divides differences of BIC in stated probabilities
SURPRISE = 5.0  # nats of prior against something that no entry describes: about one case in 150


@dataclass(frozen=True)
class Finding:
    """One effect that is there."""

    effect: str
    twins: tuple[str, ...]  # what it cannot be told from, most likely first
    probability: float
    values: dict[str, tuple[float, float]]  # by symbol, with standard errors
    gain: float  # nats of BIC beside the others
    heldout: Gain


@dataclass(frozen=True)
class Judgement:
    """What a search amounts to."""

    verdict: Verdict
    findings: tuple[Finding, ...]  # by evidence
    dropped: tuple[str, ...]  # what the search accepted and the gates did not
    left: Left  # beside `fit`
    gate: float  # nats that chance does not reach
    corrections: Gain | None  # held-out gain of the base model's own simplifications, where they stand out
    search: Search  # without what was dropped

    @property
    def fit(self) -> Fit:
        """With the effects found; the corrected base model where none was."""
        return self.search.best

    @property
    def nats_left(self) -> float:
        """Nats that something more would be worth; none where chance may be all there is."""
        return self.left.nats(self.gate)

    @property
    def more_is_left(self) -> bool:
        """Whether what remains is worth telling beside what was found."""
        return self.nats_left > WORTH_TELLING * sum(f.gain for f in self.findings)


def judged(
    found: Search, take: Take, place: Circle | None = None, left: Left | None = None, dropped: tuple[str, ...] = ()
) -> Judgement:
    """The findings that pass the gates, and the verdict.

    `place` stands out on the floor; `left` is what is left beside `found.best`.

    Where an effect does not pass, the rest is refitted without it and judged anew.
    """
    best = found.best
    left = left or Left.of(best, take, place)
    findings = _findings(found, take)
    weakest = _weakest(f for f in findings if not _passes(f, found))
    no_car = () if weakest else incredible(best, take)  # a refit with less may have led another there
    at_ends = _weakest(f for f in findings if f.effect in no_car)
    standing_in = () if weakest or at_ends else stand_ins(found, take, place, left)
    failed = (*weakest, *at_ends, *standing_in)
    if failed:
        rest = refit_with(best, take, tuple(n for n in best.hypothesis.effects if n not in failed))
        return judged(found.reduced(rest, take, standing_in, at_ends), take, place, None, (*dropped, *failed))
    verdict: Verdict = "nothing-found"
    if findings:
        verdict = "ambiguous" if any(f.twins for f in findings) else "named"
    elif left.nats(found.nulls.gate) > 0.0 or best.hypothesis.effects != found.base.hypothesis.effects:
        verdict = "unknown"
    corrections = None
    if found.corrected is not found.base:
        corrections = gain(scores(found.corrected, take), scores(found.base, take), take)
    return Judgement(
        verdict, tuple(sorted(findings, key=lambda f: -f.gain)), dropped, left, found.nulls.gate,
        corrections, found,
    )  # fmt: skip


def _weakest(failing: Iterable[Finding]) -> tuple[str, ...]:
    """The one that is worth least, if any fails: without it the others may pass."""
    return tuple(f.effect for f in sorted(failing, key=lambda f: f.gain)[:1])


def _findings(found: Search, take: Take) -> list[Finding]:
    """The named effects of the best fit with their evidence."""
    best = found.best
    if not named(best):
        return []
    with_all = scores(best, take)
    return [
        Finding(
            name, _twins(best, found, take, name), _probability(found, name), values_of(best, name),
            best.bic - less.bic, gain(with_all, scores(less, take), take, best.bent - less.bent),
        )
        for name, less in ((name, found.without[name]) for name in named(best))
    ]  # fmt: skip


def values_of(fit: Fit, name: str) -> dict[str, tuple[float, float]]:
    """An effect's parameters in a fit, by symbol, with standard errors."""
    values, entry = fit.values(), EFFECTS[name]
    return {p.symbol: values[f] for f, p in zip(entry.fields, entry.parameters, strict=True)}


def _passes(finding: Finding, found: Search) -> bool:
    entry = found.best.hypothesis.entries[finding.effect]
    matters = any(abs(finding.values[p.symbol][0]) > RELEVANT_SIZE * p.size for p in entry.amplitudes)
    sure = finding.heldout.ci95[0] > 0.0 or finding.heldout.nats > PLAIN  # few blocks of a short take scatter
    worth = finding.heldout.nats > found.nulls.local_gate if entry.places else sure
    return worth and matters and finding.gain > found.nulls.gate


def _exchanged_for(best: Fit, other: Fit, name: str) -> str | None:
    """What `other` has in place of `name`, where it is alike otherwise."""
    mine, theirs = set(best.hypothesis.effects), set(other.hypothesis.effects)
    more = [n for n in theirs - mine if n in EFFECTS]
    return more[0] if mine - theirs == {name} and len(more) == 1 else None


def _twins(best: Fit, found: Search, take: Take, name: str) -> tuple[str, ...]:
    twins = ["+".join(DELAYS)] if name == "pose_latency" else []
    for other in found.others:
        rival = _exchanged_for(best, other, name)
        if rival and rival not in twins and alike(best, other, take):
            twins.append(rival)
    return tuple(twins[:MOST_TWINS])


def alike(best: Fit, other: Fit, take: Take) -> bool:
    """Whether the evidence does not tell two fits apart: by BIC, or by the difference's own scatter (Vuong)."""
    if best.bic - other.bic < RIVAL:
        return True
    size = max(1, round(block_s(take) / SEGMENT_S))
    each = best.per_segment - other.per_segment
    sums = np.add.reduceat(each, np.arange(0, len(each), size))
    if len(sums) < 2:  # a take of one block says nothing of its scatter
        return False
    spread = float(sums.std(ddof=1)) * np.sqrt(len(sums))
    return float(each.sum()) < TELLING * spread and best.bic - other.bic < 5.0 * RIVAL


def _probability(found: Search, name: str) -> float:
    """Of the effect among itself, its rivals, nothing and something unknown."""
    best = found.best
    behind = [best.bic - o.bic for o in found.others if _exchanged_for(best, o, name)]
    nothing = best.bic - found.without[name].bic
    weights = [*behind, nothing, SURPRISE * TEMPER]
    return float(1.0 / (1.0 + np.sum(np.exp(-np.maximum(weights, 0.0) / TEMPER))))
