"""Words of a vehicle file that poses contradict, axles and marker; a hint names the word that is likely meant.

The rear axle does not move sideways but for its tyres' slip: v_y = l_r w + a v_x - k v_x^2 w, where a is the yaw offset
of the body and k the slip.  The front axle moves where it is steered: w (l_f + l_r) = v_x tan(delta) at low speed.
"""

from typing import NamedTuple

import numpy as np

from bcid.aliases import Floats
from bcid.recording.checks.limits import GEOMETRY as LIMITS
from bcid.recording.checks.single_track import servo_angles
from bcid.recording.checks.steering_fit import SteeringFit, fit_steering
from bcid.recording.checks.turning import TurningData
from bcid.vehicle import Vehicle


class ShownGeometry(NamedTuple):
    """Lengths that the motion shows (m), and how far they scatter between parts of the take."""

    rear_m: float  # from the stated CoG back to the axle that does not move sideways
    rear_sd: float
    wheelbase_m: float
    wheelbase_sd: float
    slip_m: float  # by which the tyres' slip may pass for a lever, where the speed hardly varies


def show_geometry(
    data: TurningData, vehicle: Vehicle, lag_s: float, servo: tuple[float, float]
) -> ShownGeometry | None:
    """Distance of the rear axle and wheelbase that the motion shows, the commands taken `lag_s` (s) later than stamped.

    `servo` is its time constant (s) and rate limit (rad/s).  None where the car turns too little.
    """
    body = vehicle.body
    v_x = data.speed * np.cos(data.heading)
    v_y = data.speed * np.sin(data.heading) - body.cog_to_front_m * data.turn
    w = data.turn
    delta = servo_angles(data.command_s, data.u_s, data.time_s, *servo, lag_s)
    rows = data.rows[np.abs(w[data.rows]) > LIMITS.least_turn * float(np.quantile(np.abs(w[data.rows]), 0.9))]
    block = (data.time_s[rows] // LIMITS.block_s).astype(int)
    gentle = np.abs(v_x * w) < max(LIMITS.gentle_mps2, float(np.quantile(np.abs((v_x * w)[rows]), 0.3)))
    parts, lengths = [], []
    for b in np.unique(block):
        r = rows[block == b]
        if len(r) < LIMITS.min_rows:
            continue
        X = np.column_stack([w[r], v_x[r], v_x[r] ** 2 * w[r]])
        parts.append((X.T @ X, X.T @ v_y[r]))
        g = r[gentle[r] & (np.abs(delta[r]) < LIMITS.largest_angle_rad)]
        lengths.append((float(np.sum((v_x[g] * np.tan(delta[g])) ** 2)), float(np.sum(w[g] ** 2))))
    if len(parts) < LIMITS.min_blocks:
        return None
    gram, cross = np.array([p[0] for p in parts]), np.array([p[1] for p in parts])
    sizes = np.array(lengths)
    rear = [_solve(gram.sum(0) - gram[i], cross.sum(0) - cross[i]) for i in range(len(parts))]
    total = sizes.sum(0)
    base = [float(np.sqrt((total - s)[0] / max((total - s)[1], 1e-12))) for s in sizes]
    spread = np.sqrt(len(parts) - 1.0)
    length = float(np.sqrt(total[0] / max(total[1], 1e-12)))
    return ShownGeometry(
        _solve(gram.sum(0), cross.sum(0)), float(spread * np.std(rear)), length, float(spread * np.std(base)),
        _slip_lever(gram.sum(0), v_x[rows]),
    )  # fmt: skip


def _slip_lever(gram: Floats, v_x: Floats) -> float:
    """The length (m) that the rear tyres' slip may feign at the speeds v_x (N,); 0 where these vary enough to tell.

    `gram` (3, 3) holds the products of w, v_x and v_x^2 w.
    """
    variety = 1.0 - gram[0, 2] ** 2 / max(gram[0, 0] * gram[2, 2], 1e-12)
    return 0.0 if variety > LIMITS.least_speed_variety else LIMITS.slip_lever * float(np.quantile(v_x**2, 0.9))


def hint_at_drive(data: TurningData, vehicle: Vehicle, fit: SteeringFit) -> str | None:
    """The driven axle that explains a car's turning clearly better than the stated one; None where none does.

    Only a wheel that is steered far shows where the car is driven.  `fit` is that of the stated one.
    """
    explained = fit.scale < LIMITS.explained_noise * data.noise
    if explained or float(np.abs(data.u_s).max()) < LIMITS.least_drive_angle_rad:
        return None
    given, fits = vehicle.steering, dict[str, SteeringFit]()
    stated = {"T_s": given.time_constant_s, "d": given.max_rate_radps}
    fixed = {name: value for name, value in stated.items() if value is not None}
    for drive in ("front", "rear"):
        if drive != vehicle.body.drive:
            body = vehicle.body.model_copy(update={"drive": drive, "front_drive_share": None})
            other = vehicle.model_copy(update={"body": body})
            fits[drive] = fit_steering([data], other, fixed, fit.value("delay_s"))
    best = min(fits, key=lambda drive: fits[drive].scale)
    # what poses of such noise leave of any model
    left, left_best = (max(f.scale**2 - data.noise**2, 0.0) for f in (fit, fits[best]))
    nats = fit.misfit * float(np.log((fit.scale / fits[best].scale) ** 2))
    if left_best > LIMITS.drive_left * left or nats < LIMITS.drive_nats:
        return None
    stated_drive = vehicle.body.drive
    return (
        f'the car turns as if the {best} axle were driven, the vehicle file says "{stated_drive}"; correct body.drive'
    )


def _solve(gram: Floats, cross: Floats) -> float:
    """The first weight of least squares with the normal equations `gram` (n, n) and `cross` (n,)."""
    return float(np.linalg.lstsq(gram, cross, rcond=None)[0][0])


def hint_at_geometry(shown: ShownGeometry, vehicle: Vehicle) -> str | None:
    """The word of the vehicle file that the motion contradicts, and what it likely ought to be; None where it fits."""
    body, L = vehicle.body, vehicle.body.wheelbase_m
    marker = (vehicle.mocap.marker_offset_m or (0.0, 0.0))[0]
    off = shown.rear_m - body.cog_to_rear_m
    apart = abs(off) > LIMITS.rear_share * L + LIMITS.sds * shown.rear_sd + shown.slip_m
    ratio = shown.wheelbase_m / L
    scatter = LIMITS.sds * shown.wheelbase_sd / L
    longer = ratio > LIMITS.wheelbase_factor + scatter or ratio < 1.0 / LIMITS.wheelbase_factor - scatter
    if not apart and not longer:
        return None
    moves = f"the axle that does not move sideways lies {shown.rear_m:.3g} m behind the CoG"
    turns = f"the car turns as if its wheelbase were {shown.wheelbase_m:.3g} m"
    if longer and float(vehicle.steering.max_angle_rad) > LIMITS.least_drive_angle_rad:
        return f"{turns} where the vehicle file says {L:.3g} m; correct its axles, or the unit or gain of the steering"
    if longer:
        return (
            f"{turns} where the vehicle file says {L:.3g} m; correct body.cog_to_front_m and cog_to_rear_m, or the "
            f"gain of the steering ({1.0 / ratio:.2g} times as much)"
        )
    swapped = abs(shown.rear_m - body.cog_to_front_m) < LIMITS.same_share * L
    if swapped and abs(body.cog_to_front_m - body.cog_to_rear_m) > LIMITS.rear_share * L:
        return f"{moves}: body.cog_to_front_m and cog_to_rear_m are exchanged"
    says = f"{moves} where the vehicle file says {body.cog_to_rear_m:.3g} m"
    return f"{says}; mocap.marker_offset_m = [{marker + off:.3g}, …], or correct body.cog_to_rear_m"
