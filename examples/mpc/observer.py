"""The state of a model from measured poses and past commands: an extended Kalman filter around the exported step."""

import math
from typing import Any

import casadi as ca
import numpy as np
from exported import Predictor

POSE_NOISE = (5e-4, 5e-4, 1e-3)
"""Standard deviations of a measured position (m) and yaw (rad), as data sheets of a motion capture state them."""
START_SPREAD = 0.02
"""Standard deviation of a car's twist (m/s, rad/s) and steering angle (rad) when it is first seen standing."""
PUSHES = (0.1, 0.1, 0.2)
"""Root spectral densities of what pushes the motion beside the model (m/s, m/s, rad/s per root second).

One choice for all models, so that drives differ by what plans and predicts alone.  With poses this exact an observer
follows them closely whatever stands here.
"""
STEERING_DENSITY = 0.02
"""Root spectral density (rad per root second) of what the steering angle does that no command asks for."""


class Observer:
    """What a model believes of its car: the mean `z` (n,) and the covariance `P` (n, n) of its state.

    Commands that a model remembers are carried on by its step alone: `predict` must be told every command from the
    first on, so that what stands in `z` of the past is what was sent.
    """

    def __init__(self, model: Predictor, pose: np.ndarray) -> None:
        """Begin with a car that stands at the measured `pose` (3,), its wheel straight."""
        n = len(model.states)
        self.model, self.z = model, model.init(pose, (0.0, 0.0, 0.0), 0.0)
        delta, motion = model.states.index("delta"), model.motion
        spread, density = np.zeros(n), np.zeros(n)
        spread[:3], spread[motion], spread[delta] = POSE_NOISE, START_SPREAD, START_SPREAD
        density[motion], density[delta] = PUSHES, STEERING_DENSITY
        self.P, self._Q = np.diag(spread**2), np.diag(density**2) * model.period_s
        self._R, self._H = np.diag(np.square(POSE_NOISE)), np.eye(3, n)
        z, u = ca.SX.sym("z", n), ca.SX.sym("u", 2)
        z_next = model.step(z, u)
        self._step = ca.Function("predict", [z, u], [z_next, ca.jacobian(z_next, z)])

    def predict(self, u: Any) -> None:
        """Carry the belief on by one period under the command `u` (2,): steering (rad), throttle."""
        z, A = (np.asarray(m) for m in self._step(self.z, u))
        self.z, self.P = z.ravel(), A @ self.P @ A.T + self._Q

    def update(self, pose: np.ndarray) -> np.ndarray:
        """Correct the belief by a measured `pose` (3,); returns how far that was off the predicted one (m, m, rad)."""
        off = np.asarray(pose) - self.z[:3]
        off[2] = math.remainder(off[2], 2.0 * math.pi)
        S = self._H @ self.P @ self._H.T + self._R
        K = np.linalg.solve(S, self._H @ self.P).T
        I_KH = np.eye(len(self.z)) - K @ self._H
        self.z = self.z + K @ off
        self.P = I_KH @ self.P @ I_KH.T + K @ self._R @ K.T
        return off
