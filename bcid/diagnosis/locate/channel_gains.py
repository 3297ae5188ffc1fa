"""Where the mismatch enters, before any hypothesis: what basis functions would explain, channel by channel.

At every place where physics may be missing - along the wheels, across the tyres, about the yaw axis, at the steering,
at the motor, in the tracked pose, between the clocks - a few functions of the state act with free amplitudes.  The
mismatch enters where they explain most of the residuals, base parameters projected out.  A steered front wheel pushes
along the body, across it and about it at once, so that the direction of a push in the body's frame does not tell its
channel; whether pushes have the direction of a wheel, on whatever they depend, is judged by `push_directions`.
"""

import math

import numpy as np

from bcid.aliases import Floats
from bcid.diagnosis.locate.basis_functions import ANGLE_STEP_RAD, BASIS_SIZES, wrench_basis_changes
from bcid.diagnosis.locate.scan_statistic import FloorCircle
from bcid.likelihood.lane_rollout import SegmentLayout, segment_layout
from bcid.likelihood.predict import predict_poses
from bcid.likelihood.prediction_inputs import PredictionInputs
from bcid.likelihood.projection import linearise_fit, project_out_fit
from bcid.likelihood.refit import Fit
from bcid.likelihood.score_test import unlimited_gain
from bcid.likelihood.take import Take

SERVO_MOVES_RADPS = 0.2  # above which the servo moves
CLOCK_STEP_S = 1e-3
NO_CIRCLE = FloorCircle(0.0, 0.0, 0.0, 0.0)


def channel_gains(fit: Fit, take: Take, circle: FloorCircle | None) -> dict[str, float]:
    """Log-likelihood gain (nats) by a linear regression of a fit's residuals on the basis functions of each channel.

    A channel is a place where physics may be missing: "fx", "fy", "mz", "motor", "steering", "pose" or "time"; its
    basis functions are simple functions of the state, whose coefficients are free.  The fitted parameters and each
    segment's initial state and disturbances are projected out, and ln(segments) / 2 is deducted for each function, as
    in BIC.  Some functions act only inside `circle`, if given.  The largest gain comes first.
    """
    columns, slices = pose_changes_by_channel(fit, take, circle or NO_CIRCLE)
    columns /= np.maximum(np.sqrt(np.einsum("nck,nck->k", columns, columns) / (3 * len(columns))), 1e-12)
    widest = max(own.stop - own.start for own in slices.values())
    beside = project_out_fit(linearise_fit(fit, take), columns, widest)
    gains = {
        channel: unlimited_gain(beside, own) - 0.5 * (own.stop - own.start) * math.log(take.segments)
        for channel, own in slices.items()
    }
    return dict(sorted(gains.items(), key=lambda item: -item[1]))


def pose_changes_by_channel(fit: Fit, take: Take, circle: FloorCircle) -> tuple[Floats, dict[str, slice]]:
    """Derivatives (N, 3, n) of predicted poses by the coefficients of n basis functions, and each channel's columns.

    Basis functions are functions of the state with which a regression describes missing physics in a channel ("fx",
    "steering", "pose" ...); some act only inside `circle`.  A column that is not finite is set to zero.
    """
    inputs, where = fit.hypothesis.prediction_inputs(fit.phi, take), segment_layout(take)
    still = np.asarray(predict_poses(where, fit.start, *inputs.kernel_arguments))
    pushed = wrench_basis_changes(where, fit.start, *inputs.kernel_arguments, circle, sum(BASIS_SIZES.values()))
    # BASIS_SIZES ends with the steering, whose servo functions follow its wrenches
    parts = {
        "steering": _servo_angle_changes(fit, where, inputs, still),
        "pose": _tracked_pose_changes(still),
        "time": _clock_shift_changes(fit, take, inputs, still),
    }
    slices, begin = dict[str, slice](), 0
    for channel in dict.fromkeys([*BASIS_SIZES, *parts]):
        size = BASIS_SIZES.get(channel, 0) + (parts[channel].shape[2] if channel in parts else 0)
        slices[channel] = slice(begin, begin + size)
        begin += size
    columns = np.concatenate([pushed, *parts.values()], axis=2)
    columns[:, :, ~np.isfinite(columns).all(axis=(0, 1))] = 0.0
    return columns, slices


def _servo_angle_changes(fit: Fit, layout: SegmentLayout, inputs: PredictionInputs, still: Floats) -> Floats:
    """Derivatives (N, 3, 7) of predicted poses by the coefficients of seven functions added to the steering angle.

    With the front wheel's angle d (rad) after the actuators and its rate r (rad/s) they are 1, d, |d|, d^3, r, tanh(r
    / SERVO_MOVES_RADPS) and |r|.  Finite differences by ANGLE_STEP_RAD against the unchanged prediction `still` (N,
    3).
    """
    chain = inputs.chain
    d, rate = chain.delta, np.gradient(chain.delta, 0.5 * chain.h)
    functions = (np.ones_like(d), d, np.abs(d), d**3, rate, np.tanh(rate / SERVO_MOVES_RADPS), np.abs(rate))
    turned = [inputs._replace(chain=chain._replace(delta=d + ANGLE_STEP_RAD * phi)) for phi in functions]
    poses = [np.asarray(predict_poses(layout, fit.start, *each.kernel_arguments)) for each in turned]
    return np.stack([(p - still) / ANGLE_STEP_RAD for p in poses], axis=2)


def _tracked_pose_changes(p: Floats) -> Floats:
    """Derivatives (N, 3, 4) of reported poses `p` (N, 3), x, y (m), yaw (rad), by four errors of the tracking.

    These are an offset of the tracked point along the body and one across it (m), an offset of the yaw (rad), and a
    relative scale error of positions.
    """
    cos_t, sin_t, none, one = np.cos(p[:, 2]), np.sin(p[:, 2]), np.zeros(len(p)), np.ones(len(p))
    rows = ((cos_t, sin_t, none), (-sin_t, cos_t, none), (none, none, one), (p[:, 0], p[:, 1], none))
    return np.stack([np.column_stack(r) for r in rows], axis=2)


def _clock_shift_changes(fit: Fit, take: Take, inputs: PredictionInputs, still: Floats) -> Floats:
    """Derivatives (N, 3, 2) of predicted poses by a constant offset (s) and by a linear drift of the poses' clock.

    The drift's unit is 1 s over the whole take of length T: the offset is t/T seconds, t counted from the recording's
    start.  Finite differences of predictions at time stamps CLOCK_STEP_S apart; `still` (N, 3) has the unshifted
    ones.
    """
    later = segment_layout(take)._replace(stamp_s=take.stamp_s + CLOCK_STEP_S)
    velocity = (np.asarray(predict_poses(later, fit.start, *inputs.kernel_arguments)) - still) / CLOCK_STEP_S
    zero = np.repeat(take.zero_s, np.diff(take.first))
    time = (np.bincount(take.row, take.share * take.stamp_s) - zero)[:, None]
    return np.stack([velocity, velocity * time / take.T], axis=2)
