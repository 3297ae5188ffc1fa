"""The base model fitted to recordings of a vehicle: without pushes, and under them where it misses its tangent.

Fits raise `PredictionDiverged` where the base model cannot follow a take from any start.
"""

import itertools
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from bcid.aliases import Floats
from bcid.effects.constants import Constants
from bcid.effects.entry import VehicleScale
from bcid.estimate.types import Estimate
from bcid.likelihood.divergence import map_converged, none_if_diverged
from bcid.likelihood.hypothesis import Hypothesis
from bcid.likelihood.limits import LIKELIHOOD_LIMITS
from bcid.likelihood.marginal import Scales
from bcid.likelihood.refit import Fit, evaluate_fixed, refit
from bcid.likelihood.take import Take, build_take
from bcid.physics.car import Car, integration_step, typical_inertia_and_tyres
from bcid.recording.checks.contacts import Contact
from bcid.recording.types import Recording
from bcid.vehicle import Vehicle

# the car for which the effects' sizes are declared
BUMPER_CAR_MASS_KG, BUMPER_CAR_WHEELBASE_M, BUMPER_CAR_SPEED_MPS = 319.6, 0.87, 1.9
FIRST_PUSH = 0.05  # m/s^2 and rad/s^2: where the search for the pushes' scale begins
FIRST_GRIPS = (2.0, 8.0)  # N/kg, of cars from which the base model is fitted beside the nominal one
FIRST_INERTIA = 1.3  # I_z of these cars over m l_f l_r
PART_SEGMENTS = 100  # on which starts of the base model are compared


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
) -> tuple[Take, tuple[Contact, ...], Fit]:
    """Cut recordings into 1.5 s segments and fit the base model: the take, bumps and crashes found, and the fit.

    The fit is without pushes (disturbances in the prediction); it begins at the nominal car of the `hypothesis`, with
    the parameters `assumed` (SI) of effects that it always holds.  Where the fitted car needs a finer integration
    step, take and fit are repeated with that.

    Raises:
        InputRefused: when too few segments can be used.
        PredictionDiverged: when the base model's predictions diverge from every start.
    """
    take, contacts = build_take(recordings, estimates, hypothesis.nominal, hypothesis.angle_limit)
    base = fit_base(take, hypothesis, initial_scales(take), assumed)
    while integration_step(base.car()) < take.h:  # it is stiffer than the car before
        take, contacts = build_take(recordings, estimates, base.car(), hypothesis.angle_limit)
        base = _fit_base_again(take, base, initial_scales(take))
    return take, contacts, base


def _fit_base_again(take: Take, base: Fit, scales: Scales) -> Fit:
    """The base model fitted to `take` by `fit_base` from the car and the assumed effects of the earlier fit `base`."""
    h = base.hypothesis
    return fit_base(take, replace(h, nominal=base.car()), scales, list(h.effect_values(base.phi).values()))


def initial_scales(take: Take) -> Scales:
    """First guess of the standard deviations of noise (m, m, rad) and pushes (FIRST_PUSH, in m/s^2 and rad/s^2).

    Noise is 1.4826 median |second difference| / sqrt(6) of the measured poses x, y, yaw.
    """
    spans = zip(take.first, take.first[1:], strict=False)
    second = np.concatenate([np.diff(take.pose[a:b], 2, axis=0) for a, b in spans])
    r = 1.4826 * np.median(np.abs(second), axis=0) / np.sqrt(6.0)
    return Scales(np.maximum(r, 1e-6), np.full(3, FIRST_PUSH))


def fit_base(take: Take, hypothesis: Hypothesis, scales: Scales, assumed: Sequence[float] = ()) -> Fit:
    """The base model fitted to the take from several starts; effects that it always holds begin at `assumed` (SI).

    Starts are the nominal car and cars with typical tyres of little and of much grip; only the nominal car where a
    simulation is trusted.  All are fitted to about PART_SEGMENTS segments, and the fit of greatest penalised
    log-likelihood is refitted to the whole take, with its own noise scales, then with the given `scales`, then from
    the next best start.  The first refit is returned that loses less than `max_whole_take_loss_nats` of mean
    log-likelihood per segment against its fit to the part; if none, that of greatest penalised log-likelihood.  If
    the part is the whole take, the greater of the best fit and its refits is returned.  It is never less likely than
    the nominal car.
    """
    base, nominal = hypothesis.with_effects(), hypothesis.nominal
    chosen = np.arange(0, take.segments, max(1, take.segments // PART_SEGMENTS))
    part, cars = take.part(chosen), [nominal]
    if hypothesis.trusted_simulation is None:
        size = (nominal.m, nominal.l_f, nominal.l_r, FIRST_INERTIA)
        cars += [nominal._replace(**typical_inertia_and_tyres(*size, grip, grip)) for grip in FIRST_GRIPS]
    if "d" in hypothesis.unknown_steering:  # a servo may have no limit that shows
        cars[1:] = [car._replace(d=max(car.d, 2.0 * hypothesis.angle_limit / car.T_s)) for car in cars[1:]]
    starts = [(part, base, base.phi_of(car, assumed), part.start, scales) for car in cars]
    fits = sorted(map_converged(refit, starts, required=True), key=lambda f: -f.penalised_log_likelihood)

    def refit_whole(fit: Fit, first: Scales) -> tuple[Fit, Fit]:
        """The `fit` to a part, and the refit of the whole take from it and from the scales `first`."""
        return fit, refit(take, base, fit.phi, take.start, first)

    attempts = [(fit, first) for fit in fits for first in (fit.scales, scales)]
    if part.segments == take.segments:
        found = [*fits[:1], *(whole for _, whole in itertools.islice(map_converged(refit_whole, attempts[:2]), 1))]
    else:
        found = list[Fit]()
        for fit, whole in map_converged(refit_whole, attempts, required=True):
            found.append(whole)
            if whole.per_segment.mean() > fit.per_segment.mean() - LIKELIHOOD_LIMITS.max_whole_take_loss_nats:
                found = [whole]
                break
    best = max(found, key=lambda f: f.penalised_log_likelihood)
    return _not_below_start(best, take, base.phi_of(nominal, assumed))


def _not_below_start(fit: Fit, take: Take, phi: Floats) -> Fit:
    """The `fit`, or a better one from its start `phi`, where that is likelier once its initial states have settled.

    A refit sets out with initial states and noise that are rough guesses, so that its start seems worse than it is.
    """
    settled = none_if_diverged(evaluate_fixed, take, fit.hypothesis, phi, fit.scales)
    if settled is None or settled.penalised_log_likelihood <= fit.penalised_log_likelihood:
        return fit
    again = none_if_diverged(refit, take, fit.hypothesis, phi, settled.start, settled.scales)
    return max([fit, *([again] if again else [])], key=lambda f: f.penalised_log_likelihood)
