"""Which effects a fleet of cars has, since which day, and in what share of them: the evidence of all logs together.

The diagnosis of log i says by how many nats b_ie an effect e makes the log likelier; where it does not name it, and
two others do, at the size that it has in those, as far as the log's drive shows such a size.  It may be wrong, in a
share epsilon of logs, whatever it says: an explanation that adds b nats, where the likeliest one adds m, has the
likelihood

    l(b) = (1 - epsilon) exp(b - m) + epsilon.

Without e the log has, with probability q_ie, another effect of the fleet in e's place, which adds c_ie, and nothing
otherwise.  So it weighs e against its absence as

    ln r_ie = ln l(b_ie) - ln((1 - q_ie) l(0) + q_ie l(c_ie)).

No log alone can thus show that a fleet has an effect, and one that shows another effect of the fleet instead speaks
against it.  An effect that came on day k is in a share pi of the cars since then, and in none before:

    L_e(k, pi) = product over cars of (1 - pi + pi product over the car's logs i since k of r_ie).

Where it is not known which car drove, each log is a car.  The evidence for an effect is the mean of L_e over days and
shares, each as likely as the others.  Effects are found one after the other, by the q_ie of those found before, and at
the end each is weighed anew beside all others.  Reported are as many as leave the expected share of false ones small
(the local false discovery rate: Efron, Large-Scale Inference, 2010, chapter 5).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
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
    groups, occurrences = _group_logs(cars), list[Occurrence]()

    def weigh(name: str, ratio: Floats) -> Occurrence:
        return _weigh(name, ratio, days, groups, len(effects))

    while True:
        explained = _explain(occurrences)
        known = {name for found in explained for name in found.names}
        ratios = {name: _log_ratios(logs, name, explained) for name in effects if name not in known}
        found = sorted((weigh(name, ratio) for name, ratio in ratios.items()), key=lambda o: -o.nats)
        if not found or not _are_few_false([*occurrences, found[0]]):
            break
        best, *rest = found
        near = [o.effect for o in rest if o.nats > best.nats - LIMITS.twin_nats]
        twins = tuple(name for name in near if _are_twins(logs, best, name))
        occurrences.append(best._replace(twins=twins))
    while True:
        anew = [
            weigh(one.effect, _log_ratios(logs, one.effect, _explain(o for o in occurrences if o is not one)))
            for one in occurrences
        ]
        occurrences = [one._replace(twins=old.twins) for one, old in zip(anew, occurrences, strict=True)]
        occurrences.sort(key=lambda o: -o.nats)
        if _are_few_false(occurrences):
            return occurrences
        # the least certain alone: without it the others may stand
        occurrences.pop()


class ExplainedLogs(NamedTuple):
    """An effect that was found, with those that cannot be told from it: the probability (I,) that each log has it."""

    names: frozenset[str]
    in_logs: Floats


def _explain(occurrences: Iterable[Occurrence]) -> list[ExplainedLogs]:
    """What the logs have by the effects that were found."""
    return [ExplainedLogs(frozenset((one.effect, *one.twins)), one.in_logs) for one in occurrences]


def _are_few_false(occurrences: Sequence[Occurrence]) -> bool:
    """Whether of `occurrences`, and of each first few, at most `LIMITS.false_share` are expected to be false."""
    expected_false = np.cumsum([1.0 - one.probability for one in occurrences])
    return bool(np.all(expected_false <= LIMITS.false_share * np.arange(1, len(occurrences) + 1)))


def _group_logs(cars: Sequence[str]) -> list[Ints]:
    """Indices of the logs of each car; a log of an unknown car is a car of its own."""
    known = [np.array([i for i, other in enumerate(cars) if other == car]) for car in dict.fromkeys(cars) if car]
    return [*known, *(np.array([i]) for i, car in enumerate(cars) if not car)]


def _are_twins(logs: Sequence[LogEvidence], found: Occurrence, other: str) -> bool:
    """Whether most logs that have the effect that was `found` cannot tell it from the `other`, and do not show both."""
    having = [log for log, p in zip(logs, found.in_logs.tolist(), strict=True) if p > PRESENT]
    alike = [
        log.are_alternatives(found.effect, other)
        and abs(log.best(found.effect) - log.best(other)) < LIMITS.twin_nats
        for log in having
    ]  # fmt: skip
    return sum(alike) > 0.5 * len(having)


def _log_ratios(logs: Sequence[LogEvidence], effect: str, explained: Sequence[ExplainedLogs]) -> Floats:
    """The ln r_ie (I,) of an effect, beside what else was found to be `explained`; zero where a log cannot say."""
    usual = _usual_sizes(logs, effect)
    return np.array([
        _log_ratio(log, effect, usual, [(found.names, float(found.in_logs[i])) for found in explained])
        if effect in log.effects else 0.0
        for i, log in enumerate(logs)
    ])  # fmt: skip


def _usual_sizes(logs: Sequence[LogEvidence], effect: str) -> dict[str, float]:
    """Sizes, by parameter, that an effect exceeds in most logs that name it (lower quartile); none of a single log."""
    shown = [log.sizes.get(effect, {}) for log in logs if effect in log.named]
    symbols = dict.fromkeys(symbol for sizes in shown for symbol in sizes)
    return {s: float(np.quantile([x.get(s, 0.0) for x in shown], 0.25)) for s in symbols} if len(shown) > 1 else {}


def _log_ratio(
    log: LogEvidence, effect: str, usual: Mapping[str, float], explained: Sequence[tuple[frozenset[str], float]]
) -> float:
    """The ln r_ie of one log: of the effect beside its findings, or in the place of one, whichever says more.

    `explained` are effects that were found, each with its twins, and the probability that the log has it.
    """
    ratios = list[float]()
    for way in log.ways(effect):
        if math.isfinite(way.nats):
            # how well the drive shows an effect is known beside all findings, not in the place of one
            beside_all = effect not in log.named and way.beside == log.named.keys()
            at_usual = log.at_size(way.nats, effect, usual) if beside_all else way.nats
            # one that is among the findings that stay is there in any case
            there = [(p, names & way.instead.keys()) for names, p in explained if not names & way.beside]
            likely = [(p, max(way.instead[name] for name in names)) for p, names in there if names]
            q, c = max(likely, default=(0.0, 0.0))
            ratios.append(_weigh_against(at_usual, max(0.0, at_usual, *way.instead.values()), q, c))
    return max(ratios, default=0.0)


def _weigh_against(b: float, most: float, q: float, c: float) -> float:
    """The log odds that a diagnosis gives to what adds `b` nats, where the likeliest explanation adds `most`.

    With probability `q` something else is there instead, which adds `c` nats, and nothing otherwise.
    """

    def log_likelihood(added: float) -> float:
        return float(np.logaddexp(math.log1p(-LIMITS.wrong_log_rate) + added - most, math.log(LIMITS.wrong_log_rate)))

    absent = [math.log(p) + log_likelihood(nats) for p, nats in ((1.0 - q, 0.0), (q, c)) if p > 0.0]
    return log_likelihood(b) - float(logsumexp(absent))


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
