"""The base model of a vehicle fitted to recordings of it: what it may vary, the take, and the fit.

Fits raise `PredictionDiverged` where the base model cannot follow a take from any start.
"""

from collections.abc import Sequence

import numpy as np

from bcid.effects.constants import Constants
from bcid.effects.entry import VehicleScale
from bcid.estimate.types import Estimate
from bcid.likelihood.base_fit import FIRST_PUSH, BaseFits, fit_base, refit_basins
from bcid.likelihood.hypothesis import Hypothesis
from bcid.likelihood.scales import Scales
from bcid.likelihood.take import Take, build_take
from bcid.physics.car import Car, integration_step
from bcid.recording.checks.contacts import Contact
from bcid.recording.types import Recording
from bcid.vehicle import Vehicle

# the car for which the effects' sizes are declared
BUMPER_CAR_MASS_KG, BUMPER_CAR_WHEELBASE_M, BUMPER_CAR_SPEED_MPS = 319.6, 0.87, 1.9


def effect_constants(vehicle: Vehicle) -> Constants:
    """Constants, not fitted, in the effects' equations for a vehicle: its rear track (m), and default values.

    Where the vehicle file gives no rear track, that of the bumper car is scaled in proportion to the wheelbase.
    """
    body = vehicle.body
    usual = Constants().track * (body.cog_to_front_m + body.cog_to_rear_m) / BUMPER_CAR_WHEELBASE_M
    return Constants(track=usual if body.rear_track_m is None else body.rear_track_m)


def scale_at_speed(car: Car, speed_mps: float) -> VehicleScale:
    """Mass, wheelbase, and time to drive a wheelbase at `speed_mps` (m/s) of `car`, divided by those of the bumper car.

    The bumper car (319.6 kg, 0.87 m, at 1.9 m/s) is the one for which sizes of effects are declared.
    """
    length = (car.l_f + car.l_r) / BUMPER_CAR_WHEELBASE_M
    return VehicleScale(car.m / BUMPER_CAR_MASS_KG, length, length * BUMPER_CAR_SPEED_MPS / max(speed_mps, 0.05))


def scale_at_driven_speed(car: Car, estimates: Sequence[Estimate], min_speed_mps: float = 0.0) -> VehicleScale:
    """Mass, wheelbase, and time to drive a wheelbase of `car`, divided by those of the bumper car (`scale_at_speed`).

    The speed is the 90 % quantile of |v_f| in the `estimates`, or `min_speed_mps` (m/s) if that is greater.
    """
    driven = np.quantile(np.abs(np.concatenate([e.kinematic[:, 0] for e in estimates])), 0.9)
    return scale_at_speed(car, max(float(driven), min_speed_mps))


def base_hypothesis(
    vehicle: Vehicle, car: Car, estimates: Sequence[Estimate], assumed: tuple[str, ...] = ()
) -> Hypothesis:
    """The hypothesis (which parameters a fit varies, in what bounds) of a vehicle's base model, no effect added yet.

    The nominal `car` supplies what is not fitted.  The base model always holds the `assumed` effects; T_s and d are
    fitted if the vehicle file omits them; the effects' typical sizes are scaled to the speed in the `estimates`.
    """
    steering, units = vehicle.steering, scale_at_driven_speed(car, estimates)
    servo = ("T_s", steering.time_constant_s), ("d", steering.max_rate_radps)
    unknown = tuple(symbol for symbol, given in servo if given is None)
    return Hypothesis(
        (), car, steering.max_angle_rad, effect_constants(vehicle), unknown, units, assumed, vehicle.has_raw_steering,
        measured_point=vehicle.mocap.marker_offset_m is not None,
    )  # fmt: skip


def prepare_and_fit_base(
    recordings: Sequence[Recording], estimates: Sequence[Estimate], hypothesis: Hypothesis, assumed: Sequence[float]
) -> tuple[Take, tuple[Contact, ...], BaseFits]:
    """Cut recordings into 1.5 s segments and fit the base model: the take, bumps and crashes found, and the fits.

    They begin at the nominal car of the `hypothesis` and others like it, with the parameters `assumed` (SI) of effects
    that it always holds.  Where the fitted car needs a finer integration step, the take is cut anew with that, and each
    fit goes on with it.

    Raises:
        InputRefused: when too few segments can be used.
        PredictionDiverged: when the base model's predictions diverge from every start.
    """
    take, contacts = build_take(recordings, estimates, hypothesis.nominal, hypothesis.angle_limit)
    found = fit_base(take, hypothesis, initial_scales(take), assumed)
    while integration_step(found.best.car()) < take.h:  # it is stiffer than the car before
        take, contacts = build_take(recordings, estimates, found.best.car(), hypothesis.angle_limit)
        found = refit_basins(take, found)
    return take, contacts, found


def initial_scales(take: Take) -> Scales:
    """First guess of the standard deviations of noise (m, m, rad) and pushes (FIRST_PUSH, in m/s^2 and rad/s^2).

    Noise is 1.4826 median |second difference| / sqrt(6) of the measured poses x, y, yaw.
    """
    spans = zip(take.first, take.first[1:], strict=False)
    second = np.concatenate([np.diff(take.pose[a:b], 2, axis=0) for a, b in spans])
    r = 1.4826 * np.median(np.abs(second), axis=0) / np.sqrt(6.0)
    return Scales(np.maximum(r, 1e-6), np.full(3, FIRST_PUSH))
