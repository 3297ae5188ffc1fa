"""Nuisance parameters, the initial state and the pushes of every segment: predictions from them, and their solution.

The likelihood eliminates them linearly about a point (`bcid.likelihood.marginal`).  Large pushes turn a car, so that a
tangent without pushes says nothing of them: predictions are made under the likeliest pushes, found by steps of
Levenberg and Marquardt in each segment, and what remains is linear (Laplace's approximation; the relinearised smoother
of Bell 1994).  `start` stands for the nuisance parameters (S, N_NUISANCE) of S segments throughout.
"""

from typing import Any, NamedTuple

import numpy as np

from bcid.aliases import Bools, Floats, Ints
from bcid.likelihood.divergence import require_finite
from bcid.likelihood.force_history import HISTORY, PUSHES, ForceHistory, answer_to, history_values
from bcid.likelihood.lane_rollout import SegmentLayout, segment_layout
from bcid.likelihood.limits import LIKELIHOOD_LIMITS, SEGMENT_LIMITS
from bcid.likelihood.linearised_rollout import Resolution
from bcid.likelihood.marginal import NU, Scales, estimate_scales, segment_moments
from bcid.likelihood.predict import COARSE, FINE, linearise_poses, predict_poses, wrap_yaw
from bcid.likelihood.prediction_inputs import ChangedCars, PredictionInputs
from bcid.likelihood.take import N_START, Take
from bcid.likelihood.tracking_functions import AMOUNT, tracking_changes

SEGMENT_DAMPINGS = (0.0, 0.01, 1.0, 100.0)  # of a segment's step, times the diagonal of its curvature
MIN_DAMPING = 1e-12  # without which a matrix may be singular
MAX_SEGMENT_STEPS = 16
MIN_SEGMENT_GAIN = 0.03  # nats, below which a segment has converged
# predictions that are kept: refits come back to where they were, mostly within a step's trials
RECENT_PREDICTIONS = 12
_RECENT: dict[Any, tuple[tuple[Any, ...], Floats]] = {}


class NuisanceSolution(NamedTuple):
    """Nuisance parameters, the residual there and the derivatives of the predicted poses."""

    start: Floats  # (S, N_NUISANCE)
    r: Floats  # (N, 3)
    A: Floats  # (N, 3, N_NUISANCE)


class LinearisedResiduals(NamedTuple):
    """Measured less predicted poses, and the derivatives of the predicted ones."""

    r: Floats  # (N, 3)
    A: Floats  # (N, 3, N_NUISANCE) by the nuisance parameters
    J: Floats  # (N, 3, R + K) by R parameters of the car and K coefficients of what has no name


class LinearisedHistories(NamedTuple):
    """Measured less predicted poses, and derivatives of the predicted ones by all that may act on the car."""

    r: Floats  # (N, 3)
    A: Floats  # (N, 3, N_NUISANCE) by the nuisance parameters
    J: Floats  # (N, 3, R) by R parameters of the car
    history: ForceHistory
    poses: Floats  # (N, 3) that are predicted, before what the tracking does without a name


def linearise_residuals(
    take: Take, inputs: PredictionInputs, start: Floats, changed: ChangedCars | None = None
) -> LinearisedResiduals:
    """Measured less predicted poses from `start` (S, N_NUISANCE), and derivatives of predicted poses there.

    By the variational equation, in one run: by initial states and pushes, by each parameter that is `changed`, and by
    the coefficients of what has no name, on the body and in the tracking.
    """
    functions = inputs.functions
    if not len(functions) and not len(inputs.tracking):
        poses, (by_state, J, by_pushes), _ = _linearise(take, inputs, start, changed, COARSE)
        A = np.concatenate([by_state, by_pushes], axis=2)
        return LinearisedResiduals(wrap_yaw(take.pose - poses), A, np.ascontiguousarray(J))
    r, A, J, history, poses = linearise_histories(take, inputs, start, changed)
    acting = answer_to(history.D, history_values(functions, history.along, inputs.car), take.first)
    seen = tracking_changes(inputs.tracking, poses, take.seen_rows)
    return LinearisedResiduals(r, A, np.concatenate([J, acting, seen], axis=2))


def linearise_histories(
    take: Take, inputs: PredictionInputs, start: Floats, changed: ChangedCars | None = None
) -> LinearisedHistories:
    """What `linearise_residuals` gives, with derivatives by accelerations of the body and turns of the wheel.

    They are by what acts in each knot of 0.125 s; pushes last for several.
    """
    poses, (by_state, J, D), along = _linearise(take, inputs, start, changed, FINE)
    by_pushes = (D.reshape(-1, HISTORY) @ PUSHES).reshape(len(D), 3, -1)
    A = np.concatenate([by_state, by_pushes], axis=2)
    seen = tracking_changes(inputs.tracking, poses, take.seen_rows) @ inputs.tracking[:, AMOUNT]
    r = wrap_yaw(take.pose - poses - seen)
    return LinearisedHistories(r, A, J, ForceHistory(D, along), poses)


def _linearise(
    take: Take, inputs: PredictionInputs, start: Floats, changed: ChangedCars | None, resolution: Resolution
) -> tuple[Floats, list[Floats], Floats]:
    """What `linearise_poses` gives for a take, its columns split: by initial states, by parameters, by what acts."""
    chain, car, e, c = inputs.kernel_arguments
    cars, widths = changed or ChangedCars(np.array([car]), np.zeros(0))
    poses, derivatives, along = linearise_poses(segment_layout(take), start, chain, cars, widths, resolution, e, c)
    return poses, np.split(derivatives, [N_START, N_START + len(widths)], axis=2), along


def pose_residuals(take: Take, inputs: PredictionInputs, start: Floats) -> Floats:
    """Measured less predicted poses (N, 3) x, y (m), yaw (rad), predicted from the nuisance parameters `start`.

    `start` (S, N_NUISANCE) holds each segment's initial state and pushes (constant disturbances over 0.5 s); `inputs`
    are the car, the effects' parameters and the commands after the actuators.
    """
    poses = _predict_once(segment_layout(take), inputs, start)
    if len(inputs.tracking):
        poses = poses + tracking_changes(inputs.tracking, poses, take.seen_rows) @ inputs.tracking[:, AMOUNT]
    return wrap_yaw(take.pose - poses)


def _predict_once(layout: SegmentLayout, inputs: PredictionInputs, start: Floats) -> Floats:
    """Predicted poses (N, 3) of `predict_poses`; the last RECENT_PREDICTIONS are kept, and not computed again.

    A prediction is known by which arrays its layout and its actuator chain are, and by what else stands in its inputs.
    """
    arrays = *layout, *inputs.chain
    key = (*map(id, arrays), inputs.car, inputs.switches.tobytes(), inputs.constants, start.tobytes())
    if key in _RECENT:
        return _RECENT[key][1]
    poses = np.asarray(predict_poses(layout, start, *inputs.kernel_arguments))
    if len(_RECENT) >= RECENT_PREDICTIONS:
        _RECENT.pop(next(iter(_RECENT)))
    _RECENT[key] = arrays, poses  # the arrays are kept, so that their ids stay theirs
    return poses


def remove_pushes(r: Floats, A: Floats, start: Floats, first: Ints) -> Floats:
    """Residual r + A p (N, 3) of predictions without the pushes p, to first order, by derivatives `A`.

    `r` (N, 3) is measured less predicted poses, `A` (N, 3, N_NUISANCE) the derivatives of predicted poses, both at
    the nuisance parameters `start` (S, N_NUISANCE), which hold a segment's initial state, then its pushes (constant
    disturbances over 0.5 s); segment s has the rows `first[s]` to `first[s + 1]`.
    """
    pushes = start[:, N_START:]
    if not pushes.any():
        return r
    return np.asarray(r + np.einsum("nck,nk->nc", A[:, :, N_START:], np.repeat(pushes, np.diff(first), axis=0)))


def residuals_without_pushes(take: Take, inputs: PredictionInputs, start: Floats, A: Floats) -> Floats:
    """Measured less predicted poses (N, 3) from `start`, with the effect of its pushes subtracted to first order.

    `start` (S, N_NUISANCE) holds segments' initial states and pushes (constant disturbances over 0.5 s), `A` (N, 3,
    N_NUISANCE) the derivatives of predicted poses by both.
    """
    return remove_pushes(pose_residuals(take, inputs, start), A, start, take.first)


def nuisance_sensitivities(take: Take, inputs: PredictionInputs, start: Floats) -> Floats:
    """Derivatives (N, 3, N_NUISANCE) of predicted poses by segments' initial states and pushes, at `start`.

    By the variational equation.  Pushes are disturbance accelerations, constant over 0.5 s each.
    """
    return linearise_residuals(take, inputs, start).A


def move_to_posterior(take: Take, start: Floats, z: Floats) -> Floats:
    """Initial states and pushes (S, N_NUISANCE) after a Gauss-Newton step from `start` to the posterior mean `z`.

    `z` (S, N_NUISANCE) holds the change of the initial state, which is added, and the pushes (constant disturbances
    over 0.5 s) themselves, which replace those of `start` if `take.pushed` and are ignored otherwise.
    """
    there = start.copy()
    there[:, :N_START] += z[:, :N_START]
    if take.pushed:
        there[:, N_START:] = z[:, N_START:]
    return there


def solve_nuisance(take: Take, inputs: PredictionInputs, start: Floats, scales: Scales) -> NuisanceSolution:
    """Maximum-likelihood initial state and pushes of each segment, with residual and derivatives of poses there.

    Pushes are disturbance accelerations, constant over 0.5 s.  If `take.pushed`, Levenberg-Marquardt steps begin at
    `start` (S, N_NUISANCE); otherwise `start` is returned.  A segment counts as lost in a local minimum if its
    prediction diverges or its chi^2 per measured number is SEGMENT_LIMITS.lost_misfit or more.  It is solved again
    from its measured initial state without pushes, then with its pushes halved, then from the measured state with the
    median pushes of the other segments; the solution of least chi^2 is kept.

    Raises:
        PredictionDiverged: where a prediction stays infinite or NaN all the same.
    """
    at = _solution_at(take, inputs, start.copy())
    if not take.pushed:  # one tangent does
        return at
    _descend_segments(take, inputs, at, scales)
    retries = (
        (1.0, _recorded_start),
        (SEGMENT_LIMITS.max_halved_share, _halve_pushes),
        (SEGMENT_LIMITS.max_median_share, _median_pushes),
    )
    for max_share, retry_start in retries:
        are_lost = ~(
            segment_misfit(take, at.start, at.r, scales) < SEGMENT_LIMITS.lost_misfit * 3.0 * np.diff(take.first)
        )
        begin = retry_start(take, at.start, are_lost)
        lost = np.flatnonzero(are_lost & (begin != start).any(axis=1))
        if 0 < len(lost) <= max_share * take.segments:
            _retry_segments(take, inputs, at, lost, begin, scales)
    require_finite("a prediction", at.r)
    return at


def _solution_at(take: Take, inputs: PredictionInputs, start: Floats) -> NuisanceSolution:
    """Initial states and pushes `start` (S, N_NUISANCE), unchanged, with residuals and derivatives of poses there."""
    at = linearise_residuals(take, inputs, start)
    return NuisanceSolution(start, at.r, at.A)


def _recorded_start(take: Take, start: Floats, lost: Bools) -> Floats:
    """Initial states by the measured poses, with zero pushes: (S, N_NUISANCE).  `start`, `lost` are unused."""
    return take.start


def _halve_pushes(take: Take, start: Floats, lost: Bools) -> Floats:
    """Initial states of `start` (S, N_NUISANCE) with its pushes (accelerations) halved; `lost` is unused."""
    return np.hstack([start[:, :N_START], 0.5 * start[:, N_START:]])


def _median_pushes(take: Take, start: Floats, lost: Bools) -> Floats:
    """Initial states estimated from measured poses, with the median pushes in `start` of segments not `lost` (S,).

    Returns (S, N_NUISANCE), every segment with the same pushes (disturbance accelerations); zero ones if all are
    lost.
    """
    if lost.all():
        return take.start
    median = np.broadcast_to(np.median(start[~lost, N_START:], axis=0), (len(start), start.shape[1] - N_START))
    return np.hstack([take.start[:, :N_START], median])


def _descend_segments(take: Take, inputs: PredictionInputs, at: NuisanceSolution, scales: Scales) -> None:
    """Optimise initial states and pushes in `at`, in place, by Levenberg-Marquardt steps in each segment separately.

    A segment stops when a step lowers its Student's t cost by MIN_SEGMENT_GAIN nats or less; one whose prediction is
    not finite stays as it is.
    """
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
    """Optimise initial states and pushes of the segments `lost` (indices) again, from `begin` (S, N_NUISANCE).

    The new solution overwrites that in `at` for each segment in which its weighted sum of squares is less.
    """
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
    """Mean cost (nats a segment) of linearising predictions in initial states and pushes: true less linearised misfit.

    The misfit is Student's t cost at the best-fitting initial states and pushes of the linear prediction, by
    derivatives `A` (N, 3, N_NUISANCE) at `start`; the true one is predicted anew there.  The difference in one
    segment is capped at `max_segment_nonlinearity_nats`, which also stands for a diverged one, so that no single
    segment decides the mean.
    """
    e = estimate_scales(segment_moments(residuals_without_pushes(take, inputs, start, A), A, take.first), scales, 0)[1]
    there = move_to_posterior(take._replace(pushed=True), start, e.z)
    worse = segment_misfit(take, there, pose_residuals(take, inputs, there), scales)
    each, most = _student_cost(worse, take), LIKELIHOOD_LIMITS.max_segment_nonlinearity_nats
    each -= _student_cost(e.chi2, take)
    return float(np.where(each < most, each, most).mean())  # NaN, of a diverged segment, counts as the most


def segment_misfit(take: Take, start: Floats, r: Floats, scales: Scales) -> Floats:
    """Weighted sum of squares |r / noise|^2 + |pushes / q|^2 (S,) of each segment: chi^2 at its minimum.

    The minimum is over initial states and pushes, `start` (S, N_NUISANCE).  `r` (N, 3) is measured less predicted
    poses, `scales` holds the standard deviations of noise and pushes.
    """
    with np.errstate(over="ignore"):  # a diverged prediction is infinitely bad
        each = np.add.reduceat(((r / scales.r) ** 2).sum(axis=1), take.first[:-1])
    return np.asarray(each + start**2 @ scales.nuisance_precisions())


def _student_cost(misfit: Floats, take: Take) -> Floats:
    """Negative log-likelihood (nu + n)/2 log(1 + misfit/nu) (S,) in nats of segments by Student's t, less a constant.

    `misfit` (S,) is a segment's weighted sum of squares, n its count of measured numbers less 6, nu = NU.
    """
    return np.asarray(0.5 * (NU + 3.0 * np.diff(take.first) - N_START) * np.log1p(np.maximum(misfit, 0.0) / NU))


def _damped_step(take: Take, inputs: PredictionInputs, at: NuisanceSolution, scales: Scales) -> tuple[Floats, Floats]:
    """Initial states and pushes (S, N_NUISANCE), residual (N, 3) after a Levenberg-Marquardt step in each segment.

    The step starts at `at`; its damping grows through SEGMENT_DAMPINGS until the segment's weighted sum of squares
    falls.  A segment stays where no damping does it, where its derivatives are not finite, or where those by one of
    its nuisances are all zero.
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
