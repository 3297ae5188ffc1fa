"""Which effects a fleet of cars has, since which day, and in what share of them: the evidence of all logs together.

The diagnosis of log i says by how many nats b_ie an effect e makes the log likelier.  It may be wrong, in a share
epsilon of logs whatever it says, so that beside the likeliest explanation, of m_i nats, an effect has the likelihood

    l_ie = (1 - epsilon) exp(b_ie - m_i) + epsilon,   no effect l_i0 = (1 - epsilon) exp(-m_i) + epsilon.

No log alone can thus show that a fleet has an effect, and a log that shows another one says that it is not this.  An
effect that came on day k is in a share pi of the cars since then, and in none before:

    L_e(k, pi) = product over cars of (1 - pi + pi product over the car's logs i since k of l_ie / l_i0).

Where it is not known which car drove, each log is a car.  The evidence for an effect is the mean of L_e over days and
shares, each as likely as the others; effects are found one after the other, and what one explains is no evidence for
the next.  Reported are as many as leave the expected share of false ones small (the local false discovery rate: Efron,
Large-Scale Inference, 2010, chapter 5).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from scipy.special import logsumexp

from bcid.aliases import Floats, Ints
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
    twins: tuple[str, ...]  # effects that explain the logs nearly as well, best first


def find_occurrences(logs: Sequence[LogEvidence], days: Sequence[int], cars: Sequence[str]) -> list[Occurrence]:
    """The effects that a fleet has, the most certain first; `days` count from 0, and an unknown car is "".

    Of those that are told a share of `LIMITS.false_share` is expected to be false.
    """
    effects = sorted({name for log in logs for name in (*log.named, *log.others)})
    members, found, doubt = _group_logs(cars), list[Occurrence](), 0.0
    explained = dict[str, Floats]()
    while left := [name for name in effects if name not in explained]:
        ratios = _log_ratios(logs, left, explained)
        tables = [_likelihood_table(ratio, days, members) for ratio in ratios]
        evidence = np.array([logsumexp(table) - np.log(table.size) for table in tables])
        best = int(np.argmax(evidence))
        odds = evidence[best] - np.log(len(effects))
        doubt += 1.0 / (1.0 + np.exp(min(odds, 700.0)))
        if doubt > LIMITS.false_share * (len(found) + 1):
            break
        near = np.flatnonzero(evidence > evidence[best] - LIMITS.twin_nats)
        twins = [left[j] for j in near[np.argsort(-evidence[near])] if j != best]
        told = _describe(left[best], float(odds), tables[best], ratios[best], days, members, twins)
        found.append(told)
        explained[told.effect] = told.in_logs
        # what cannot be told from it is not found a second time
        explained |= dict.fromkeys(twins, told.in_logs)
    return found


def _group_logs(cars: Sequence[str]) -> list[Ints]:
    """Indices of the logs of each car; a log of an unknown car is a car of its own."""
    known = dict.fromkeys(car for car in cars if car)
    of_known = [np.array([i for i, other in enumerate(cars) if other == car]) for car in known]
    return [*of_known, *(np.array([i]) for i, car in enumerate(cars) if not car)]


def _log_ratios(logs: Sequence[LogEvidence], effects: Sequence[str], explained: Mapping[str, Floats]) -> list[Floats]:
    """The ln(l_ie / l_i0) of each effect in each log (I,), less what effects that were found have `explained` there."""
    nats = np.array([[_unexplained_nats(log, i, e, explained) for e in effects] for i, log in enumerate(logs)])
    most = np.maximum(nats.max(axis=1, initial=0.0), 0.0)
    wrong, right = np.log(LIMITS.wrong_log_rate), np.log1p(-LIMITS.wrong_log_rate)
    with_it = np.logaddexp(right + nats - most[:, None], wrong)
    return list((with_it - np.logaddexp(right - most, wrong)[:, None]).T)


def _unexplained_nats(log: LogEvidence, number: int, effect: str, explained: Mapping[str, Floats]) -> float:
    """Nats that an effect adds to a log beside those that were found; none where the log cannot say."""
    nats = log.nats(effect)
    if nats is None:
        return 0.0
    taken = max((p[number] for name, p in explained.items() if log.are_alternatives(name, effect)), default=0.0)
    return (1.0 - taken) * nats


def _likelihood_table(ratio: Floats, days: Sequence[int], members: Iterable[Ints]) -> Floats:
    """The ln L_e(k, pi) by day k and share pi, (D, P)."""
    members, since = list(members), np.asarray(days)
    return np.array([
        np.sum([_log_mixture(float(ratio[own][since[own] >= k].sum())) for own in members], axis=0)
        for k in range(max(days) + 1)
    ])  # fmt: skip


def _log_mixture(ratio: float) -> Floats:
    """The ln(1 - pi + pi exp(ratio)) over the SHARES."""
    return np.asarray(np.logaddexp(np.log1p(-SHARES), np.log(SHARES) + ratio))


def _describe(
    effect: str, odds: float, table: Floats, ratio: Floats, days: Sequence[int], members: Sequence[Ints],
    twins: Sequence[str],
) -> Occurrence:  # fmt: skip
    """What is known of an effect that is found at log odds `odds`, from its likelihoods by day and share."""
    posterior = np.exp(table - logsumexp(table))
    by_day = posterior.sum(axis=1)
    day = int(np.argmax(by_day))
    by_share = posterior[day] / posterior[day].sum()
    since = np.asarray(days)
    in_logs = np.zeros(len(days))
    for own in members:
        later = own[since[own] >= day]
        if len(later):
            r = float(ratio[later].sum())
            has_it = 1.0 / (1.0 + np.exp(np.clip(np.log1p(-SHARES) - np.log(SHARES) - r, -700.0, 700.0)))
            in_logs[later] = float(by_share @ has_it)
    low, high = np.interp((0.05, 0.95), np.cumsum(by_share), SHARES)
    return Occurrence(
        effect, 1.0 / (1.0 + np.exp(-odds)), float(logsumexp(table) - np.log(table.size)), day, float(by_day[day]),
        float(by_share @ SHARES), (float(low), float(high)), in_logs, tuple(twins),
    )  # fmt: skip
