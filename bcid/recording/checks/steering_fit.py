"""The servo and the commands' delay, fitted to how the car turns: a single-track car led along its measured speed.

The yaw that it predicts and the measured yaw pass the same differentiating filter, so that the filter's length biases
nothing: minimised is sum_k (D[psi] - D[psi_hat(theta)])_k^2 / s^2 + sum_i ((theta_i - m_i) / sd_i)^2 over servo, delay
and the car's tyres and inertia, which keep wide priors about what is typical of any vehicle of its size.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from bcid.aliases import Bools, Floats, Ints
from bcid.recording.checks.limits import SERVO as LIMITS
from bcid.recording.checks.single_track import SingleTrack, servo_angles, turn_along
from bcid.recording.checks.turning import TurningData, filtered_rate
from bcid.vehicle import Vehicle

NAMES = (
    "T_s", "d", "delay_s", "c_f", "c_r", "g_f", "g_r", "j", "v_0", "gain_left", "gain_right", "trim",
)  # fmt: skip
"""What is fitted, by its index in theta; all but the delay and the trim as natural logarithms."""
LINEAR = np.array([name in ("delay_s", "trim") for name in NAMES])
TYPICAL = {"T_s": 0.12, "d": 6.0, "delay_s": 0.0, "c_f": 18.0, "c_r": 30.0, "g_f": 3.5, "g_r": 4.0, "v_0": 0.6,
           "gain_left": 1.0, "gain_right": 1.0, "trim": 0.0}  # fmt: skip
PRIOR_SD = {"T_s": 2.0, "d": 2.0, "delay_s": 3.0, "c_f": 0.8, "c_r": 0.8, "g_f": 0.8, "g_r": 0.8, "j": 0.5,
            "v_0": 0.6, "gain_left": 0.15, "gain_right": 0.15, "trim": 0.05}  # fmt: skip
"""Centres and standard deviations of the priors: natural logarithms of SI values, but s and rad for delay and trim."""
STARTS = ((0.05, 10.0), (0.1, 4.0), (0.15, 1.5), (0.3, 1.0), (0.4, 10.0))  # T_s and d of the servos tried first
START_DELAYS_S = (0.0, -0.05, -0.1, -0.2)  # the lag of the turning holds that of the tyres, too
START_TYRES = ({"c_f": 12.0, "c_r": 25.0, "v_0": 1.0}, {"c_f": 28.0, "c_r": 34.0, "v_0": 0.4})
TRIED_STARTS = 3
STEP = 1e-4  # of the numerical derivatives
FIRST_ITERATIONS, MAX_ITERATIONS, SMALL_GAIN = 8, 20, 1e-5


Residuals = Callable[[Floats], Floats]
"""From theta to the residuals (K,) of the filtered yaw rate (rad/s)."""


@dataclass(frozen=True)
class SteeringFit:
    """The fitted values by the order of NAMES, their covariance, and what of the turning they explain."""

    theta: Floats
    covariance: Floats
    free: Bools
    explained: float
    rms: float  # of the residuals, rad/s
    misfit: float  # half the weighted sum of squares, in nats
    scale: float  # root mean square of the residuals without their outliers, rad/s

    def value(self, name: str) -> float:
        """The value of one constant, in SI units."""
        i = NAMES.index(name)
        return float(self.theta[i] if LINEAR[i] else np.exp(self.theta[i]))

    def sd(self, name: str) -> float:
        """The standard deviation of one constant: of its natural logarithm, but of delay and trim in s and rad."""
        i = NAMES.index(name)
        return float(np.sqrt(self.covariance[i, i]))

    def lag(self) -> tuple[float, float]:
        """The sum of delay and time constant (s), and its standard deviation: what poses show without knowing which."""
        i, k = NAMES.index("delay_s"), NAMES.index("T_s")
        T_s = self.value("T_s") if self.free[k] else 0.0
        gradient = np.zeros(len(NAMES))
        gradient[i], gradient[k] = 1.0, T_s
        return self.value("delay_s") + self.value("T_s"), float(np.sqrt(gradient @ self.covariance @ gradient))


def systematic_delay_s(data: TurningData, T_s: float, known: bool) -> float:
    """The error (s) of a fitted delay that no scatter shows: of the grid, of tyres unlike the model's, of the servo.

    `known` says whether the servo's time constant T_s (s) is stated; a fitted one is traded for delay where the real
    servo is not of first order.
    """
    share = LIMITS.systematic_share if known else LIMITS.systematic_share_fitted
    return float(np.hypot(LIMITS.systematic_steps * data.step_s, share * max(T_s, LIMITS.least_lag_s)))


def car_at(theta: Floats, vehicle: Vehicle) -> SingleTrack:
    """The single-track car of the parameters `theta`, with the axles and drive of the vehicle file."""
    value = dict(zip(NAMES, np.where(LINEAR, theta, np.exp(np.where(LINEAR, 0.0, theta))).tolist(), strict=True))
    return SingleTrack(
        vehicle.body.cog_to_front_m, vehicle.body.cog_to_rear_m, vehicle.front_share,
        *(value[n] for n in ("c_f", "c_r", "g_f", "g_r", "j", "v_0", "gain_left", "gain_right", "trim")),
    )  # fmt: skip


def predicted_turn(theta: Floats, data: TurningData, vehicle: Vehicle) -> Floats:
    """Filtered yaw rate (N,) in rad/s that the parameters `theta` predict from commands and measured speed."""
    T_s, d, delay_s = np.exp(theta[0]), np.exp(theta[1]), theta[2]
    delta = servo_angles(data.command_s, data.u_s, data.time_s, T_s, d, delay_s)
    turn = turn_along(
        data.time_s, delta, data.speed, data.speed_rate, data.restart, data.heading, data.turn, car_at(theta, vehicle)
    )
    yaw = np.r_[0.0, np.cumsum(0.5 * (turn[1:] + turn[:-1]) * data.step_s)]
    return filtered_rate(yaw, data.half_window, data.step_s)


def fit_steering(
    takes: list[TurningData], vehicle: Vehicle, fixed: dict[str, float], delay_s: float = 0.0,
    start: Floats | None = None,
) -> SteeringFit:  # fmt: skip
    """Servo, delay and car that explain the turning of the `takes` best, with the covariance of what is free.

    Args:
        takes: one or more recordings of the same car.
        vehicle: its axles and drive.
        fixed: constants by their name in NAMES that keep a value, in SI units.
        delay_s: where the search for the delay begins (s), if it is free.
        start: theta from which the search begins; None tries several servos.
    """
    centre, sd = _priors(vehicle, delay_s)
    free = np.array([name not in fixed for name in NAMES])
    for name, value in fixed.items():
        i = NAMES.index(name)
        centre[i] = value if LINEAR[i] else np.log(value)
    turns = np.concatenate([take.turn[take.rows] for take in takes])

    trust = np.ones(len(turns))

    def residuals(theta: Floats) -> Floats:
        left = [(t.turn - predicted_turn(theta, t, vehicle))[t.rows] for t in takes]
        return np.asarray(trust * np.concatenate(left))

    starts = [np.where(free, start, centre)] if start is not None else _list_starts(centre, free)
    tried = sorted(starts, key=lambda theta: float(np.sum(residuals(theta) ** 2)))[:TRIED_STARTS]
    begun = [_minimise(residuals, theta, centre, sd, free, 1.0, FIRST_ITERATIONS) for theta in tried]
    best = min(begun, key=lambda fit: float(np.sum(fit.residuals**2)))
    block = np.concatenate([
        1_000_000 * i + (t.time_s[t.rows] // LIMITS.block_s).astype(int) for i, t in enumerate(takes)
    ])  # fmt: skip
    trust = _trust(best.residuals)
    best = _minimise(residuals, best.theta, centre, sd, free, 1.0, FIRST_ITERATIONS)
    # residuals of a model that is not the car's last: so many rows tell as much as one
    repeats = max(1.0, _score_ratio(best, block))
    best = _minimise(residuals, best.theta, centre, sd, free, repeats, MAX_ITERATIONS)
    repeats = max(1.0, _score_ratio(best, block) * repeats)
    best = _minimise(residuals, best.theta, centre, sd, free, repeats, MAX_ITERATIONS)
    P = np.diag(1.0 / sd[free] ** 2)
    H = np.linalg.inv(best.weight * best.jacobian.T @ best.jacobian + P)
    scores = _block_scores(best, block)
    inflation = len(scores) / max(len(scores) - free.sum(), 1.0)
    covariance = np.zeros((len(NAMES), len(NAMES)))
    # repeats stand in the weight already, where scores are no larger than it says
    middle = np.maximum(1.0, _score_ratio(best, block)) * best.weight * best.jacobian.T @ best.jacobian
    sandwich = H @ (inflation * scores.T @ scores + P) @ H
    covariance[np.ix_(free, free)] = 0.5 * (sandwich + H @ (inflation * middle + P) @ H)
    trust = np.ones(len(turns))
    r = residuals(best.theta)
    return SteeringFit(
        best.theta, covariance, free, 1.0 - float(np.sum(r**2) / np.sum((turns - turns.mean()) ** 2)),
        float(np.sqrt(np.mean(r**2))), 0.5 * best.weight * float(best.residuals @ best.residuals),
        float(np.sqrt(np.mean(best.residuals**2))),
    )  # fmt: skip


def _list_starts(centre: Floats, free: Bools) -> list[Floats]:
    """Values of theta at which a search may begin: servos, delays and tyres of several kinds about the `centre`."""
    starts = []
    for T_s, d in STARTS if free[:2].any() else STARTS[:1]:
        for delay_s in START_DELAYS_S if free[2] else (0.0,):
            for tyres in START_TYRES:
                theta = centre.copy()
                theta[:2] = np.where(free[:2], np.log([T_s, d]), theta[:2])
                theta[2] += delay_s
                for name, value in tyres.items():
                    theta[NAMES.index(name)] = np.log(value)
                starts.append(theta)
    return starts


def _trust(residuals: Floats) -> Floats:
    """Square roots of the weights (K,) that Huber's loss gives to `residuals` (K,): 1 but where they are outliers."""
    usual = float(np.median(np.abs(residuals))) / 0.6745
    return np.sqrt(np.minimum(1.0, LIMITS.outlier * usual / np.maximum(np.abs(residuals), 1e-12)))


class _Minimum(NamedTuple):
    """Where a search has ended."""

    theta: Floats
    jacobian: Floats  # (K, n) of the residuals by what is free
    residuals: Floats  # (K,)
    weight: float  # of a squared residual


def _block_scores(fit: _Minimum, block: Ints) -> Floats:
    """Gradients (B, n) of half the weighted squares, block by block; `block` (K,) names that of each residual."""
    products = fit.jacobian * fit.residuals[:, None]
    # rows of a block follow each other
    return np.add.reduceat(products, np.flatnonzero(np.r_[True, np.diff(block) != 0]), axis=0) * fit.weight


def _score_ratio(fit: _Minimum, block: Ints) -> float:
    """How many times larger the scatter of the blocks' scores is than the weight of independent residuals says."""
    scores = _block_scores(fit, block)
    naive = fit.weight * fit.jacobian.T @ fit.jacobian
    scale = 1e-9 * np.trace(naive) / len(naive) * np.eye(len(naive))
    return float(np.trace(np.linalg.solve(naive + scale, scores.T @ scores)) / len(naive))


def _priors(vehicle: Vehicle, delay_s: float) -> tuple[Floats, Floats]:
    """Centres and standard deviations of the priors on theta for a vehicle, the delay's about `delay_s` (s)."""
    typical = TYPICAL | {"j": vehicle.body.cog_to_front_m * vehicle.body.cog_to_rear_m, "delay_s": delay_s}
    centre = np.array([typical[n] if LINEAR[i] else np.log(typical[n]) for i, n in enumerate(NAMES)])
    return centre, np.array([PRIOR_SD[n] for n in NAMES])


def _minimise(
    residuals: Residuals, theta: Floats, centre: Floats, sd: Floats, free: Bools, repeats: float, iterations: int
) -> _Minimum:
    """Least squares with priors by Levenberg and Marquardt.

    The weight of a squared residual is one over its mean square, and over the number of rows that tell as much as one,
    `repeats`.
    """
    r = residuals(theta)
    J = _jacobian(residuals, theta, r, free)
    damping, P = 1e-3, 1.0 / sd[free] ** 2
    for _ in range(iterations):
        weight = 1.0 / (float(np.mean(r**2)) * repeats)
        A = weight * J.T @ J + np.diag(P)
        gradient = weight * J.T @ r + P * (theta - centre)[free]
        before = weight * float(r @ r) + float(np.sum(P * (theta - centre)[free] ** 2))
        better, after = False, before
        for _ in range(6):
            trial = theta.copy()
            move = np.linalg.solve(A + damping * np.diag(np.diag(A)), -gradient)
            trial[free] += np.clip(move, -1.0, 1.0)
            r_trial = residuals(trial)
            after = weight * float(r_trial @ r_trial) + float(np.sum(P * (trial - centre)[free] ** 2))
            if np.isfinite(after) and after < before:
                theta, r, damping, better = trial, r_trial, damping / 5.0, True
                break
            damping *= 6.0
        if not better:
            break
        J = _jacobian(residuals, theta, r, free)
        if before - after < SMALL_GAIN * max(before, 1.0) + SMALL_GAIN:
            break
    return _Minimum(theta, J, r, 1.0 / (float(np.mean(r**2)) * repeats))


def _jacobian(residuals: Residuals, theta: Floats, r: Floats, free: Bools) -> Floats:
    """Derivatives (K, n) of the `residuals` (K,), which are `r` at `theta`, by the n free parameters."""
    columns = []
    for i in np.flatnonzero(free):
        moved = theta.copy()
        step = STEP if not LINEAR[i] else 1e-3
        moved[i] += step
        columns.append((residuals(moved) - r) / step)
    return np.column_stack(columns)
