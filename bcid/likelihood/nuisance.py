"""What is free in every segment, its initial state and the pushes on it: predictions from it, its likeliest value.

The likelihood eliminates it linearly (`bcid.likelihood.marginal`), about a point.  Pushes far from nothing turn a
car, so that a tangent at rest says nothing of them: predictions are made under the likeliest pushes, found by steps
of Levenberg and Marquardt in each segment, and what remains is linear (Laplace's approximation; the relinearised
smoother of Bell 1994).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from bcid.aliases import Bools, Floats, Ints
from bcid.likelihood.hypothesis import Setting
from bcid.likelihood.lane_rollout import layout
from bcid.likelihood.marginal import NU, Scales, moments, rescaled
from bcid.likelihood.predict import free_sensitivities, predict, wrapped
from bcid.likelihood.take import N_START, Take

DAMPINGS = (0.0, 0.01, 1.0, 100.0)  # of a segment's step, times the diagonal of its curvature
ROUNDING = 1e-12  # of the same, without which a matrix may be singular
TANGENTS = 16  # at most, along which segments settle
SETTLED = 0.03  # nats that a segment still gains by a step
SPUN = 10.0  # nats by which a tangent misses a segment, beyond which it does not matter by how many
LOST = 20.0  # badness for each number measured (about 1 is expected) from which a segment has missed its mode
HOPELESS = 0.5  # share of the segments beyond which being lost is the parameters' fault, not theirs
ALMOST_ALL = 0.9  # beyond which the few others do not say what usually pushes


class Settled(NamedTuple):
    """Free parts, the residual there and how predictions answer."""

    start: Floats  # (S, N_FREE)
    r: Floats  # (N, 3)
    A: Floats  # (N, 3, N_FREE)


def residuals(take: Take, setting: Setting, start: Floats) -> Floats:
    """Measured less predicted poses (N, 3), the predictions from the free parts `start` (S, N_FREE)."""
    return wrapped(take.pose - np.asarray(predict(layout(take), start, *setting.acting)))


def without_pushes(r: Floats, A: Floats, start: Floats, first: Ints) -> Floats:
    """The residual (N, 3) as it is without the pushes in `start`, by the tangent `A` at `start` from `r` there.

    The likelihood's linear algebra starts from it, as if nothing had been pushed.
    """
    pushes = start[:, N_START:]
    if not pushes.any():
        return r
    return np.asarray(r + np.einsum("nck,nk->nc", A[:, :, N_START:], np.repeat(pushes, np.diff(first), axis=0)))


def deviations(take: Take, setting: Setting, start: Floats, A: Floats) -> Floats:
    """The residuals (N, 3) at `start`, without its pushes."""
    return without_pushes(residuals(take, setting, start), A, start, take.first)


def sensitivities(take: Take, setting: Setting, start: Floats) -> Floats:
    """D pose / d `start` (N, 3, N_FREE)."""
    return np.asarray(free_sensitivities(layout(take), start, *setting.acting))


def moved(take: Take, start: Floats, z: Floats) -> Floats:
    """Free parts with initial states at the posterior's mean `z`, and with its pushes where predictions have any."""
    there = start.copy()
    there[:, :N_START] += z[:, :N_START]
    if take.pushed:
        there[:, N_START:] = z[:, N_START:]
    return there


def settled(take: Take, setting: Setting, start: Floats, scales: Scales) -> Settled:
    """The likeliest free parts from `start` on, each segment for itself; as they are where predictions have no pushes.

    Segments that are lost, in a lesser mode or beyond the finite numbers, settle anew from their rough beginnings
    without pushes, which other parameters may have called for; then from half the pushes; then from their beginnings
    under what pushes the others: a car that lacks a brake spins without, and each segment that stays lost costs
    hundreds of nats.

    Raises:
        FloatingPointError: where predictions leave the finite numbers all the same.
    """
    at = Settled(start.copy(), residuals(take, setting, start), sensitivities(take, setting, start))
    if not take.pushed:  # one tangent does
        return at
    _settle(take, setting, at, np.flatnonzero(np.isfinite(badness(take, start, at.r, scales))), scales)
    for begins, most in ((_unpushed, 1.0), (_half_pushed, HOPELESS), (_usually_pushed, ALMOST_ALL)):
        are_lost = ~(badness(take, at.start, at.r, scales) < LOST * 3.0 * np.diff(take.first))
        begin = begins(take, at.start, are_lost)
        lost = np.flatnonzero(are_lost & (begin != start).any(axis=1))
        if 0 < len(lost) <= most * take.segments:
            _settle_anew(take, setting, at, lost, begin, scales)
    if not np.isfinite(at.r).all():
        raise FloatingPointError("a prediction left the finite numbers")
    return at


def _unpushed(take: Take, start: Floats, lost: Bools) -> Floats:
    """As the recording has them, without pushes."""
    return take.start


def _half_pushed(take: Take, start: Floats, lost: Bools) -> Floats:
    """Where they are, under half their pushes."""
    return np.hstack([start[:, :N_START], 0.5 * start[:, N_START:]])


def _usually_pushed(take: Take, start: Floats, lost: Bools) -> Floats:
    """As the recording has them, under the median pushes of the segments that are not lost."""
    if lost.all():
        return take.start
    usual = np.median(start[~lost, N_START:], axis=0)
    return np.hstack([take.start[:, :N_START], np.broadcast_to(usual, (len(start), len(usual)))])


def _settle(take: Take, setting: Setting, at: Settled, waiting: Ints, scales: Scales) -> None:
    """Move those of the segments `waiting` that gain by it, in place, until none does."""
    for _ in range(TANGENTS):
        if not len(waiting):
            break
        part, rows = take.part(waiting), take.rows(waiting)
        before = badness(part, at.start[waiting], at.r[rows], scales)
        now = Settled(at.start[waiting], at.r[rows], at.A[rows])
        at.start[waiting], at.r[rows] = _stepped(part, setting, now, scales)
        gained = _against(before, part) - _against(badness(part, at.start[waiting], at.r[rows], scales), part)
        waiting = waiting[gained > SETTLED]
        at.A[take.rows(waiting)] = sensitivities(take.part(waiting), setting, at.start[waiting])


def _settle_anew(take: Take, setting: Setting, at: Settled, lost: Ints, begin: Floats, scales: Scales) -> None:
    """Settle the segments `lost` from `begin`; in place, where that ends better."""
    part, start = take.part(lost), begin[lost]
    there = Settled(start, residuals(part, setting, start), sensitivities(part, setting, start))
    _settle(part, setting, there, np.flatnonzero(np.isfinite(badness(part, start, there.r, scales))), scales)
    before, after = (
        np.nan_to_num(badness(part, start, r, scales), nan=np.inf)
        for start, r in ((at.start[lost], at.r[take.rows(lost)]), (there.start, there.r))
    )
    better = np.flatnonzero(after < before)
    to, of = take.rows(lost[better]), part.rows(better)
    at.start[lost[better]], at.r[to], at.A[to] = there.start[better], there.r[of], there.A[of]


def bent(take: Take, setting: Setting, start: Floats, scales: Scales, A: Floats) -> float:
    """Nats per segment by which predictions at the posterior's mean are worse than their tangent `A` says.

    Of a segment no more than SPUN: a car that spins bends any tangent, and one segment in fifty outweighed all others.
    """
    e = rescaled(moments(deviations(take, setting, start, A), A, take.first), scales, 0)[1]
    there = moved(take._replace(pushed=True), start, e.z)
    worse = badness(take, there, residuals(take, setting, there), scales)
    each = _against(worse, take) - _against(e.chi2, take)
    return float(np.where(each < SPUN, each, SPUN).mean())  # what left the finite numbers has spun as well


def badness(take: Take, start: Floats, r: Floats, scales: Scales) -> Floats:
    """|r / noise|^2 + |pushes / q|^2 of every segment (S,): where it has settled, the likelihood's chi^2."""
    with np.errstate(over="ignore"):  # what has left the finite numbers is endlessly bad
        each = np.add.reduceat(((r / scales.r) ** 2).sum(axis=1), take.first[:-1])
    return np.asarray(each + start**2 @ scales.precisions())


def _against(badness: Floats, take: Take) -> Floats:
    """Nats that Student's law holds against each segment of such a badness (S,)."""
    return np.asarray(0.5 * (NU + 3.0 * np.diff(take.first) - N_START) * np.log1p(np.maximum(badness, 0.0) / NU))


def _stepped(take: Take, setting: Setting, at: Settled, scales: Scales) -> tuple[Floats, Floats]:
    """Free parts after one damped step of those segments that gain by it, and the residual there.

    Where predictions answer beyond the finite numbers, or not at all to one of the free parts, there is none.
    """
    of, known, weight = moments(at.r, at.A, take.first), scales.precisions(), scales.r**-2.0
    M = np.einsum("c,scij->sij", weight, of.AA) + np.diag(known)
    b = np.einsum("c,sci->si", weight, of.Ar) - known * at.start
    least, start, r = badness(take, at.start, at.r, scales), at.start.copy(), at.r.copy()
    diagonal = np.einsum("sii->si", M)
    waiting = np.flatnonzero(np.isfinite(M).all(axis=(1, 2)) & (diagonal > 0.0).all(axis=1))
    for damping in DAMPINGS:
        if not len(waiting):
            break
        part, rows, there = take.part(waiting), take.rows(waiting), start[waiting]
        damped = M[waiting] + (damping + ROUNDING) * diagonal[waiting, :, None] * np.eye(M.shape[1])
        there += np.linalg.solve(damped, b[waiting][:, :, None])[:, :, 0]
        left = residuals(part, setting, there)
        better = np.flatnonzero(badness(part, there, left, scales) < least[waiting])
        start[waiting[better]], r[rows[part.rows(better)]] = there[better], left[part.rows(better)]
        waiting = np.delete(waiting, better)
    return start, r
