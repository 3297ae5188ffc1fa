"""Nuisance parameters, the initial state and the pushes of every segment: predictions from them, and derivatives.

The likelihood eliminates them linearly (`bcid.likelihood.marginal`), about an initial state and pushes that a refit
moves to their posterior means: where a model lacks much the pushes are large, and predictions without them are no place
to differentiate.  `start` stands for the nuisance parameters (S, N_NUISANCE) of S segments throughout.
"""

from typing import Any, NamedTuple

import numpy as np

from bcid.aliases import Floats, Ints
from bcid.likelihood.force_history import HISTORY, PUSHES, ForceHistory, answer_to, history_values
from bcid.likelihood.lane_rollout import SegmentLayout, segment_layout
from bcid.likelihood.linearised_rollout import Resolution
from bcid.likelihood.predict import COARSE, FINE, linearise_poses, predict_poses, wrap_yaw
from bcid.likelihood.prediction_inputs import ChangedCars, PredictionInputs
from bcid.likelihood.take import N_START, Take
from bcid.likelihood.tracking_functions import AMOUNT, tracking_changes

# predictions that are kept: refits come back to where they were, mostly within a step's trials
RECENT_PREDICTIONS = 12
_RECENT: dict[Any, tuple[tuple[Any, ...], Floats]] = {}


class AboutNuisances(NamedTuple):
    """Measured less predicted poses, and the derivatives of the predicted ones by the nuisance parameters."""

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


def linearise_nuisances(take: Take, inputs: PredictionInputs, start: Floats) -> AboutNuisances:
    """Measured less predicted poses from `start` (S, N_NUISANCE), and derivatives of predicted poses by it.

    By the variational equation.  Pushes are disturbance accelerations, constant over 0.25 s each.
    """
    poses, (by_state, _, by_pushes), _ = _linearise(take, inputs, start, None, COARSE)
    return AboutNuisances(_residuals(take, inputs, poses), np.concatenate([by_state, by_pushes], axis=2))


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
        return LinearisedResiduals(_residuals(take, inputs, poses), A, np.ascontiguousarray(J))
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
    return LinearisedHistories(_residuals(take, inputs, poses), A, J, ForceHistory(D, along), poses)


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

    `start` (S, N_NUISANCE) holds each segment's initial state and pushes (constant disturbances over 0.25 s); `inputs`
    are the car, the effects' parameters and the commands after the actuators.
    """
    return _residuals(take, inputs, _predict_once(segment_layout(take), inputs, start))


def _residuals(take: Take, inputs: PredictionInputs, poses: Floats) -> Floats:
    """Measured less predicted `poses` (N, 3), these as the tracking shows them by what it does without a name."""
    tracking = np.concatenate([inputs.known_tracking, inputs.tracking])
    if len(tracking):
        poses = poses + tracking_changes(tracking, poses, take.seen_rows) @ tracking[:, AMOUNT]
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


def posterior_step(start: Floats, z: Floats) -> Floats:
    """The Gauss-Newton step (S, N_NUISANCE) of initial states and pushes from `start` to their posterior means.

    `z` (S, N_NUISANCE) is the posterior mean: the change of the initial state, and then the pushes.
    """
    step = z - start
    step[:, :N_START] = z[:, :N_START]
    return step


def without_pushes(start: Floats) -> Floats:
    """The initial states of `start` (S, N_NUISANCE), and no pushes."""
    there = start.copy()
    there[:, N_START:] = 0.0
    return there


def about_no_pushes(r: Floats, A: Floats, start: Floats, first: Ints) -> Floats:
    """The residual (N, 3) that predictions would have without the pushes in `start`, were they as linear as there.

    `r` (N, 3) is the residual and `A` (N, 3, N_NUISANCE) are the derivatives of predictions at `start`; segment s has
    the rows `first[s]` to `first[s + 1]`.  With this residual pushes count from zero, where their prior lies.
    """
    pushes = start[:, N_START:]
    if not pushes.any():
        return r
    there = np.repeat(pushes, np.diff(first), axis=0)
    return np.asarray(r + np.einsum("ncp,np->nc", A[:, :, N_START:], there))
