"""Nuisance parameters, the initial state and the pushes of every segment: predictions from them, and their solution.

The likelihood eliminates them linearly about a point (`bcid.likelihood.marginal`).  Large pushes turn a car, so that a
tangent without pushes says nothing of them: predictions are made under the likeliest pushes, found by steps of
Levenberg and Marquardt in each segment, and what remains is linear (Laplace's approximation; the relinearised smoother
of Bell 1994).  `start` stands for the nuisance parameters (S, N_NUISANCE) of S segments throughout.
"""

from typing import NamedTuple

import numpy as np

from bcid.aliases import Bools, Floats, Ints
from bcid.likelihood.divergence import require_finite
from bcid.likelihood.lane_rollout import segment_layout
from bcid.likelihood.limits import LIKELIHOOD_LIMITS
from bcid.likelihood.marginal import NU, Scales, estimate_scales, segment_moments
from bcid.likelihood.predict import pose_sensitivities, predict_poses, wrap_yaw
from bcid.likelihood.prediction_inputs import PredictionInputs
from bcid.likelihood.take import N_START, Take

SEGMENT_DAMPINGS = (0.0, 0.01, 1.0, 100.0)  # of a segment's step, times the diagonal of its curvature
MIN_DAMPING = 1e-12  # without which a matrix may be singular
MAX_SEGMENT_STEPS = 16
MIN_SEGMENT_GAIN = 0.03  # nats, below which a segment has converged
LOST_MISFIT = 20.0  # misfit for each number measured (about 1 is expected) from which a segment is in a lesser mode
# shares of lost segments beyond which it is the parameters' fault, and beyond which the others do not say what pushes
MAX_HALVED_SHARE, MAX_MEDIAN_SHARE = 0.5, 0.9


class NuisanceSolution(NamedTuple):
    """Nuisance parameters, the residual there and the derivatives of the predicted poses."""

    start: Floats  # (S, N_NUISANCE)
    r: Floats  # (N, 3)
    A: Floats  # (N, 3, N_NUISANCE)


def pose_residuals(take: Take, inputs: PredictionInputs, start: Floats) -> Floats:
    """Measured less predicted poses (N, 3), predicted from the nuisance parameters `start` (S, N_NUISANCE)."""
    return wrap_yaw(take.pose - np.asarray(predict_poses(segment_layout(take), start, *inputs.kernel_arguments)))


def remove_pushes(r: Floats, A: Floats, start: Floats, first: Ints) -> Floats:
    """The residual (N, 3) that predictions without the pushes in `start` leave, by the tangent `A` (N, 3, N_NUISANCE).

    The tangent runs from the residual `r` at `start`.  Segment s has the rows `first[s]` to `first[s + 1]`.
    """
    pushes = start[:, N_START:]
    if not pushes.any():
        return r
    return np.asarray(r + np.einsum("nck,nk->nc", A[:, :, N_START:], np.repeat(pushes, np.diff(first), axis=0)))


def residuals_without_pushes(take: Take, inputs: PredictionInputs, start: Floats, A: Floats) -> Floats:
    """Measured less predicted poses (N, 3) from `start`, its pushes taken out by the tangent `A` (N, 3, N_NUISANCE)."""
    return remove_pushes(pose_residuals(take, inputs, start), A, start, take.first)


def nuisance_sensitivities(take: Take, inputs: PredictionInputs, start: Floats) -> Floats:
    """Derivatives (N, 3, N_NUISANCE) of the predicted poses by the nuisance parameters at `start`."""
    return np.asarray(pose_sensitivities(segment_layout(take), start, *inputs.kernel_arguments))


def move_to_posterior(take: Take, start: Floats, z: Floats) -> Floats:
    """Nuisance parameters with initial states moved by the posterior mean `z`, and its pushes if `take.pushed`."""
    there = start.copy()
    there[:, :N_START] += z[:, :N_START]
    if take.pushed:
        there[:, N_START:] = z[:, N_START:]
    return there


def solve_nuisance(take: Take, inputs: PredictionInputs, start: Floats, scales: Scales) -> NuisanceSolution:
    """The likeliest nuisance parameters near `start`, each segment for itself; `start` as it is unless `take.pushed`.

    A segment is lost if its prediction diverges or its misfit exceeds LOST_MISFIT, in a lesser mode of the likelihood.
    It is solved again from its recorded initial state without pushes, then from half the pushes, then from that state
    under the median push of the other segments: a car that lacks a brake spins without it, and each segment that stays
    lost costs hundreds of nats.

    Raises:
        PredictionDiverged: where a prediction is not finite all the same.
    """
    at = _solution_at(take, inputs, start.copy())
    if not take.pushed:  # one tangent does
        return at
    _descend_segments(take, inputs, at, scales)
    for k, most in enumerate((1.0, MAX_HALVED_SHARE, MAX_MEDIAN_SHARE)):
        are_lost = ~(segment_misfit(take, at.start, at.r, scales) < LOST_MISFIT * 3.0 * np.diff(take.first))
        begin = _retry_starts(take, at.start, are_lost)[k]
        lost = np.flatnonzero(are_lost & (begin != start).any(axis=1))
        if 0 < len(lost) <= most * take.segments:
            _retry_segments(take, inputs, at, lost, begin, scales)
    require_finite("a prediction", at.r)
    return at


def _solution_at(take: Take, inputs: PredictionInputs, start: Floats) -> NuisanceSolution:
    """The nuisance parameters `start`, and residual and derivatives of the predictions from them."""
    return NuisanceSolution(start, pose_residuals(take, inputs, start), nuisance_sensitivities(take, inputs, start))


def _retry_starts(take: Take, start: Floats, lost: Bools) -> tuple[Floats, Floats, Floats]:
    """Three sets of nuisance parameters from which lost segments are tried again.

    Recorded initial states without pushes; `start` under half its pushes; recorded initial states under the median
    pushes of the segments that are not `lost`.
    """
    halved = np.hstack([start[:, :N_START], 0.5 * start[:, N_START:]])
    if lost.all():
        return take.start, halved, take.start
    median = np.broadcast_to(np.median(start[~lost, N_START:], axis=0), (len(start), start.shape[1] - N_START))
    return take.start, halved, np.hstack([take.start[:, :N_START], median])


def _descend_segments(take: Take, inputs: PredictionInputs, at: NuisanceSolution, scales: Scales) -> None:
    """Move the segments of `at` with finite predictions, in place, by damped steps until none gains by another."""
    waiting = np.flatnonzero(np.isfinite(segment_misfit(take, at.start, at.r, scales)))
    for _ in range(MAX_SEGMENT_STEPS):
        if not len(waiting):
            break
        part, rows = take.part(waiting), take.rows(waiting)
        before = segment_misfit(part, at.start[waiting], at.r[rows], scales)
        now = NuisanceSolution(at.start[waiting], at.r[rows], at.A[rows])
        at.start[waiting], at.r[rows] = _damped_step(part, inputs, now, scales)
        after = segment_misfit(part, at.start[waiting], at.r[rows], scales)
        waiting = waiting[_student_cost(before, part) - _student_cost(after, part) > MIN_SEGMENT_GAIN]
        at.A[take.rows(waiting)] = nuisance_sensitivities(take.part(waiting), inputs, at.start[waiting])


def _retry_segments(
    take: Take, inputs: PredictionInputs, at: NuisanceSolution, lost: Ints, begin: Floats, scales: Scales
) -> None:
    """Solve the segments `lost` of `at` again from `begin`; in place, where that ends better."""
    part = take.part(lost)
    there = _solution_at(part, inputs, begin[lost])
    _descend_segments(part, inputs, there, scales)
    before, after = (
        np.nan_to_num(segment_misfit(part, start, r, scales), nan=np.inf)
        for start, r in ((at.start[lost], at.r[take.rows(lost)]), (there.start, there.r))
    )
    better = np.flatnonzero(after < before)
    to, of = take.rows(lost[better]), part.rows(better)
    at.start[lost[better]], at.r[to], at.A[to] = there.start[better], there.r[of], there.A[of]


def nonlinearity(take: Take, inputs: PredictionInputs, start: Floats, scales: Scales, A: Floats) -> float:
    """Mean nats per segment by which predictions at the posterior mean are worse than their tangent `A` promises.

    A segment counts `max_segment_nonlinearity_nats` at most: one in fifty that spins would outweigh all others.
    """
    e = estimate_scales(segment_moments(residuals_without_pushes(take, inputs, start, A), A, take.first), scales, 0)[1]
    there = move_to_posterior(take._replace(pushed=True), start, e.z)
    worse = segment_misfit(take, there, pose_residuals(take, inputs, there), scales)
    each, most = _student_cost(worse, take), LIKELIHOOD_LIMITS.max_segment_nonlinearity_nats
    each -= _student_cost(e.chi2, take)
    return float(np.where(each < most, each, most).mean())  # NaN, of a diverged segment, counts as the most


def segment_misfit(take: Take, start: Floats, r: Floats, scales: Scales) -> Floats:
    """|r / noise|^2 + |pushes / q|^2 of every segment (S,): the likelihood's chi^2 where it has converged."""
    with np.errstate(over="ignore"):  # a diverged prediction is infinitely bad
        each = np.add.reduceat(((r / scales.r) ** 2).sum(axis=1), take.first[:-1])
    return np.asarray(each + start**2 @ scales.nuisance_precisions())


def _student_cost(misfit: Floats, take: Take) -> Floats:
    """Negative log-likelihood (S,) under Student's t of segments of a `misfit` (S,), less a constant (nats)."""
    return np.asarray(0.5 * (NU + 3.0 * np.diff(take.first) - N_START) * np.log1p(np.maximum(misfit, 0.0) / NU))


def _damped_step(take: Take, inputs: PredictionInputs, at: NuisanceSolution, scales: Scales) -> tuple[Floats, Floats]:
    """Nuisance parameters and residual after one step of Levenberg and Marquardt in each segment that gains by it.

    A segment stays where its derivatives are not finite, or zero by one of its nuisance parameters.
    """
    moments, known, weight = segment_moments(at.r, at.A, take.first), scales.nuisance_precisions(), scales.r**-2.0
    M = np.einsum("c,scij->sij", weight, moments.AA) + np.diag(known)
    b = np.einsum("c,sci->si", weight, moments.Ar) - known * at.start
    least, start, r = segment_misfit(take, at.start, at.r, scales), at.start.copy(), at.r.copy()
    diagonal = np.einsum("sii->si", M)
    waiting = np.flatnonzero(np.isfinite(M).all(axis=(1, 2)) & (diagonal > 0.0).all(axis=1))
    for damping in SEGMENT_DAMPINGS:
        if not len(waiting):
            break
        part, rows, there = take.part(waiting), take.rows(waiting), start[waiting]
        damped = M[waiting] + (damping + MIN_DAMPING) * diagonal[waiting, :, None] * np.eye(M.shape[1])
        there += np.linalg.solve(damped, b[waiting][:, :, None])[:, :, 0]
        there_r = pose_residuals(part, inputs, there)
        better = np.flatnonzero(segment_misfit(part, there, there_r, scales) < least[waiting])
        start[waiting[better]], r[rows[part.rows(better)]] = there[better], there_r[part.rows(better)]
        waiting = np.delete(waiting, better)
    return start, r
