"""Which effects a fleet of cars has, since which day, and in what share of them: the evidence of all logs together.

The diagnosis of log i says by how many nats b_ie an effect e makes the log likelier; where it does not name it, and
two others do, at the size that it has in those.  It may be wrong, in a share epsilon of logs, whatever it says.  So,
m_ie being the largest of b_ie, zero (nothing) and what adds most in e's place in that log, it weighs e against its
absence as

    ln r_ie = ln((1 - epsilon) exp(b_ie - m_ie) + epsilon) - ln((1 - epsilon) exp(-m_ie) + epsilon).

No log alone can thus show that a fleet has an effect, and one that shows another effect instead speaks against it.  An
effect that came on day k is in a share pi of the cars since then, and in none before:

    L_e(k, pi) = product over cars of (1 - pi + pi product over the car's logs i since k of r_ie).

Where it is not known which car drove, each log is a car.  The evidence for an effect is the mean of L_e over days and
shares, each as likely as the others; effects are found one after the other, and what one explains is no evidence for
those that could stand in its place.  Reported are as many as leave the expected share of false ones small (the local
false discovery rate: Efron, Large-Scale Inference, 2010, chapter 5).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from scipy.special import expit, logsumexp

from bcid.aliases import Floats, Ints
from bcid.documents.fleet import PRESENT
from bcid.fleet.limits import LIMITS
from bcid.fleet.log_evidence import LogEvidence

SHARES = (np.arange(200) + 0.5) / 200.0
"""Shares pi over which the evidence is averaged."""


class Occurrence(NamedTuple):
    """An effect that a fleet has: since which day, in what share, in which logs."""

    effect: str
    probability: float  # that the fleet has it
    nats: float  # of evidence for it
    day: int  # index of the day since which it is likeliest to be there
    day_probability: float
    share: float  # mean of the share of cars that have it since then
    share_interval: tuple[float, float]  # 90 %
    in_logs: Floats  # (I,) the probability that each log has it
    twins: tuple[str, ...]  # effects that explain the same logs nearly as well, best first


def find_occurrences(logs: Sequence[LogEvidence], days: Sequence[int], cars: Sequence[str]) -> list[Occurrence]:
    """The effects that a fleet has, the most certain first; `days` count from 0, and an unknown car is "".

    Of those that are reported a share of `LIMITS.false_share` is expected to be false.
    """
    effects = sorted(set[str]().union(*(log.effects for log in logs)))
    groups, occurrences, expected_false = _group_logs(cars), list[Occurrence](), 0.0
    explained = dict[str, Floats]()
    while candidates := [name for name in effects if name not in explained]:
        ratios = {name: _log_ratios(logs, name, explained) for name in candidates}
        found = [_weigh(name, ratio, days, groups, len(effects)) for name, ratio in ratios.items()]
        best = max(found, key=lambda occurrence: occurrence.nats)
        expected_false += 1.0 - best.probability
        if expected_false > LIMITS.false_share * (len(occurrences) + 1):
            break
        near = sorted((o for o in found if o.nats > best.nats - LIMITS.twin_nats), key=lambda o: -o.nats)
        twins = tuple(o.effect for o in near if o is not best and _are_twins(logs, best, o.effect))
        occurrences.append(best._replace(twins=twins))
        # what cannot be told from it is not found a second time
        explained |= dict.fromkeys((best.effect, *twins), best.in_logs)
    return occurrences


def _group_logs(cars: Sequence[str]) -> list[Ints]:
    """Indices of the logs of each car; a log of an unknown car is a car of its own."""
    known = [np.array([i for i, other in enumerate(cars) if other == car]) for car in dict.fromkeys(cars) if car]
    return [*known, *(np.array([i]) for i, car in enumerate(cars) if not car)]


def _are_twins(logs: Sequence[LogEvidence], found: Occurrence, other: str) -> bool:
    """Whether most logs that have the effect that was `found` show it or the `other`, and not both."""
    having = [log for log, p in zip(logs, found.in_logs.tolist(), strict=True) if p > PRESENT]
    alternatives = sum(log.are_alternatives(found.effect, other) for log in having)
    return alternatives > 0.5 * len(having)


def _log_ratios(logs: Sequence[LogEvidence], effect: str, explained: Mapping[str, Floats]) -> Floats:
    """The ln r_ie (I,) of an effect, less what effects found have `explained`; zero where a log cannot say."""
    usual = _usual_nats(logs, effect)
    return np.array([
        _log_ratio(log, effect, usual, {name: float(p[i]) for name, p in explained.items()})
        if effect in log.effects else 0.0
        for i, log in enumerate(logs)
    ])  # fmt: skip


def _usual_nats(logs: Sequence[LogEvidence], effect: str) -> float | None:
    """Nats an effect adds to a stretch of most logs that name it, the lower quartile; None where fewer than two do."""
    named = [log.nats_a_stretch(effect) for log in logs if effect in log.named]
    return float(np.quantile(named, 0.25)) if len(named) > 1 else None


def _log_ratio(log: LogEvidence, effect: str, usual: float | None, explained: Mapping[str, float]) -> float:
    """The ln r_ie of one log: of the effect beside its findings, or in the place of one, whichever says more.

    `explained` is the probability that the log has each of the effects that were found.
    """
    beside = max((p for name, p in explained.items() if _stand_for_each_other(log, name, effect)), default=0.0)
    ways = [(log.beside(effect), 1.0 - beside)]
    ways += [(nats, 1.0 - explained.get(finding, 0.0)) for finding, nats in log.in_place(effect).items()]
    instead = [log.best(other) for other in log.effects if other != effect and log.are_alternatives(effect, other)]
    found = -math.inf
    for nats, unexplained in ways:
        if not math.isfinite(nats):
            continue
        at_usual = nats if usual is None or effect in log.named else log.at_size(nats, effect, usual)
        found = max(found, unexplained * _weigh_against(at_usual, max([0.0, at_usual, *instead])))
    return found if math.isfinite(found) else 0.0


def _stand_for_each_other(log: LogEvidence, found: str, effect: str) -> bool:
    """Whether what a log says of an effect beside its findings is explained where it has another that was `found`.

    Where it names that, the effect is weighed beside it.
    """
    return found not in log.named and log.are_alternatives(found, effect)


def _weigh_against(nats: float, most: float) -> float:
    """The log odds that a diagnosis gives to what adds `nats`, where the likeliest explanation adds `most`."""
    right, wrong = math.log1p(-LIMITS.wrong_log_rate), math.log(LIMITS.wrong_log_rate)
    return float(np.logaddexp(right + nats - most, wrong) - np.logaddexp(right - most, wrong))


def _weigh(effect: str, ratio: Floats, days: Sequence[int], groups: Sequence[Ints], effects: int) -> Occurrence:
    """What the log odds of an effect in each log say of the fleet; each of so many `effects` is as likely to be its."""
    since = np.asarray(days)
    by_car = np.array([[ratio[own][since[own] >= k].sum() for own in groups] for k in range(max(days) + 1)])
    table = np.logaddexp(np.log1p(-SHARES), np.log(SHARES) + by_car[:, :, None]).sum(axis=1)  # ln L_e(k, pi)
    nats = float(logsumexp(table) - np.log(table.size))
    posterior = np.exp(table - logsumexp(table))
    by_day = posterior.sum(axis=1)
    day = int(np.argmax(by_day))
    by_share = posterior[day] / by_day[day]
    has_it = expit(np.log(SHARES / (1.0 - SHARES)) + by_car[:, :, None])  # each car, since each day, for each share
    in_cars = np.einsum("kp,kcp->kc", posterior, has_it)
    in_logs = np.zeros(len(days))
    for car, own in enumerate(groups):
        in_logs[own] = [in_cars[: since[i] + 1, car].sum() for i in own]
    low, high = np.interp((0.05, 0.95), np.cumsum(by_share), SHARES)
    return Occurrence(
        effect, float(expit(nats - np.log(effects))), nats, day, float(by_day[day]), float(by_share @ SHARES),
        (float(low), float(high)), in_logs, (),
    )  # fmt: skip
