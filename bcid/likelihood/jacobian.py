"""Derivatives of predicted poses by the parameters of a hypothesis.

Base parameters that act on the body go along with the variational equation; effects, and an unknown servo, which acts
ahead of the body, are differences of predictions.  These are narrow: from an initial state that stays where it was, a
car that rolls to rest ends elsewhere after a small change, and what initial states do not take up of that would pass
for information.  They are wide where an effect is off, which is a kink or a jump of some (a lag is there or not), and
of a place, whose edge has to pass over poses.
"""

from collections.abc import Sequence

import numpy as np

from bcid.aliases import Floats, Ints
from bcid.likelihood.divergence import require_finite
from bcid.likelihood.hypothesis import Hypothesis
from bcid.likelihood.nuisance import linearise_residuals, pose_residuals
from bcid.likelihood.predict import wrap_yaw
from bcid.likelihood.prediction_inputs import ChangedCars
from bcid.likelihood.take import Take

# difference steps of base parameters, and of effects in units of their size
BASE_STEP, EFFECT_STEP, WIDE_STEP = 1e-3, 5e-4, 0.05
CAR_STEP = 1e-6  # of base parameters in phi, where rates are differentiated at one state
SERVO = ("T_s", "d")  # base parameters that act ahead of the body


def body_parameters(hypothesis: Hypothesis) -> Ints:
    """Indices (R,) in phi of the base parameters that act on the body: all but those of an unknown servo."""
    return np.array([j for j, s in enumerate(hypothesis.parameter_names[: hypothesis.base_size]) if s not in SERVO])


def changed_cars(hypothesis: Hypothesis, phi: Floats) -> ChangedCars:
    """The car at the parameter vector phi, and one with each of the `body_parameters` greater by CAR_STEP in phi."""
    rows, components = [hypothesis.car(phi)], body_parameters(hypothesis)
    for j in components:
        moved = phi.copy()
        moved[j] += CAR_STEP
        rows.append(hypothesis.car(moved))
    return ChangedCars(np.array(rows), np.full(len(components), CAR_STEP))


def base_jacobian(take: Take, hypothesis: Hypothesis, phi: Floats, start: Floats, r: Floats) -> Floats:
    """Derivatives (N, 3, base_size + K) of predicted poses by base parameters at phi, from `start` (S, N_NUISANCE).

    By the variational equation, and by finite differences of predictions for those of an unknown servo.  Those by K
    coefficients of the hypothesis's remainder follow, over their prior standard deviations.  `r` (N, 3) is the residual
    there.

    Raises:
        PredictionDiverged: where a derivative is not finite.
    """
    J = linearise_residuals(take, hypothesis.prediction_inputs(phi, take), start, changed_cars(hypothesis, phi)).J
    R = len(body_parameters(hypothesis))
    base = on_body_and_servo(take, hypothesis, phi, start, r, J[:, :, :R])
    return np.concatenate([base, J[:, :, R:] * hypothesis.remainder.sd], axis=2) if J.shape[2] > R else base


def on_body_and_servo(
    take: Take, hypothesis: Hypothesis, phi: Floats, start: Floats, r: Floats, on_body: Floats
) -> Floats:
    """Derivatives (N, 3, base_size) of predicted poses by base parameters, those by an unknown servo among them.

    `on_body` (N, 3, R) are those by `body_parameters`; the servo's are differences of predictions.

    Raises:
        PredictionDiverged: where a derivative is not finite.
    """
    require_finite("a prediction", on_body)
    acting = body_parameters(hypothesis)
    servo = [j for j in range(hypothesis.base_size) if j not in acting]
    out = np.empty((*r.shape, hypothesis.base_size))
    out[:, :, acting] = on_body
    if servo:
        out[:, :, servo] = parameter_jacobian(take, hypothesis, phi, start, r, servo)
    return out


def parameter_jacobian(
    take: Take, hypothesis: Hypothesis, phi: Floats, start: Floats, r: Floats, components: Sequence[int]
) -> Floats:
    """Derivatives (N, 3, n) of predicted poses by n `components` of phi, by one-sided finite differences.

    The parameter vector phi holds the logarithms of base parameters, drag, then effects' parameters.  Predictions
    begin at the nuisance parameters `start` (S, N_NUISANCE), initial states and pushes; `r` (N, 3) is the residual at
    phi.  A difference is taken downwards where an upward one would leave the bounds.
    """
    _, high = hypothesis.bounds()
    columns, wide = [], hypothesis.is_place | hypothesis.is_off(phi)
    for j in components:
        width = BASE_STEP if j < hypothesis.base_size else WIDE_STEP if wide[j] else EFFECT_STEP
        moved = phi.copy()
        moved[j] += width if phi[j] + width <= high[j] else -width
        there = pose_residuals(take, hypothesis.prediction_inputs(moved, take), start)
        columns.append(wrap_yaw(r - there) / (moved[j] - phi[j]))
        require_finite("a prediction", columns[-1])  # LAPACK would not come back from it
    return np.stack(columns, axis=2) if columns else np.zeros((*r.shape, 0))
