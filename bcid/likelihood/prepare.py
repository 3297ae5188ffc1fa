"""Recordings of a vehicle as one take, and the base model fitted to it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from bcid.effects.constants import Constants
from bcid.effects.entry import Units
from bcid.errors import InputRefused
from bcid.estimate.types import Estimate
from bcid.likelihood.hypothesis import Hypothesis
from bcid.likelihood.marginal import Scales
from bcid.likelihood.nuisance import bent
from bcid.likelihood.refit import Fit, refit
from bcid.likelihood.take import Take, joined, moving, take_of, without_beginning, without_contacts
from bcid.physics.car import Car, integration_step, with_usual_tyres
from bcid.recording.checks.contacts import Contact, contacts
from bcid.recording.types import Recording
from bcid.vehicle import Vehicle


class _Yardstick(NamedTuple):
    mass_kg: float
    length_m: float
    speed_mps: float


BUMPER_CAR = _Yardstick(319.6, 0.87, 1.9)
FEWEST_SEGMENTS = 20
MOST_BENT = 0.5  # nats per segment by which predictions may miss their tangent without being made under pushes
FIRST_PUSH = 0.05  # m/s^2 and rad/s^2: where the search for the pushes' scale begins


def constants_of(vehicle: Vehicle) -> Constants:
    """The effects' held constants; rear wheels as far apart as the bumper car's, for its wheelbase, where not given."""
    body = vehicle.body
    usual = Constants().track * (body.cog_to_front_m + body.cog_to_rear_m) / BUMPER_CAR.length_m
    return Constants(track=usual if body.rear_track_m is None else body.rear_track_m)


def units_at(car: Car, speed_mps: float) -> Units:
    """A vehicle of that speed against the bumper car, for which sizes are declared.

    By its mass, its wheelbase and the time to drive a wheelbase.
    """
    length = (car.l_f + car.l_r) / BUMPER_CAR.length_m
    return Units(car.m / BUMPER_CAR.mass_kg, length, length * BUMPER_CAR.speed_mps / max(speed_mps, 0.05))


def units_of(car: Car, estimates: Sequence[Estimate], at_least: float = 0.0) -> Units:
    """The same of a car as fast as it was driven, or as `at_least` so many m/s."""
    driven = np.quantile(np.abs(np.concatenate([e.kinematic[:, 0] for e in estimates])), 0.9)
    return units_at(car, max(float(driven), at_least))


def prepared(
    recordings: Sequence[Recording], estimates: Sequence[Estimate], car: Car, limit: float
) -> tuple[Take, tuple[Contact, ...]]:
    """The recordings as one take of what can be predicted, for steps that suit the car, steered to +-`limit` (rad).

    Without contacts, what stands still, and beginnings in which nobody knows where the wheel stands.

    Raises:
        InputRefused: when too little of it can be used.
    """
    parts, hits = [], []
    for recording, estimate in zip(recordings, estimates, strict=True):
        found = contacts(recording)
        hits += found
        whole = without_beginning(take_of(recording, estimate, integration_step(car)), car.T_s, car.d, limit)
        parts.append(moving(without_contacts(whole, found), car.l_f + car.l_r))
    usable = sum(take.segments for take in parts)
    if usable < FEWEST_SEGMENTS:
        raise InputRefused(
            recordings[0].sources[0].path, "poses",
            f"only {usable} stretches of 1.5 s in motion can be used, {FEWEST_SEGMENTS} are the least",
            "record a longer take with fewer gaps",
        )  # fmt: skip
    return joined([take for take in parts if take.segments]), tuple(hits)


def base_of(vehicle: Vehicle, car: Car, estimates: Sequence[Estimate], assumed: tuple[str, ...] = ()) -> Hypothesis:
    """The base model of a vehicle about `car`, with what it assumes."""
    steering = vehicle.steering
    unknown = tuple(
        s for s, given in (("T_s", steering.time_constant_s), ("d", steering.max_rate_radps)) if given is None
    )
    return Hypothesis(
        (), car, steering.max_angle_rad, constants_of(vehicle), unknown, units_of(car, estimates), assumed,
        vehicle.raw_steering, measured_point=vehicle.mocap.marker_offset_m is not None,
    )  # fmt: skip


def base_from(
    recordings: Sequence[Recording], estimates: Sequence[Estimate], hypothesis: Hypothesis, assumed: Sequence[float]
) -> tuple[Take, tuple[Contact, ...], Fit]:
    """The take, its contacts and the base model's fit, in steps that the fitted car bears; without pushes.

    Raises:
        InputRefused: when too little of the recordings can be used.
        FloatingPointError: when the base model cannot follow them.
    """
    take, hits = prepared(recordings, estimates, hypothesis.nominal, hypothesis.angle_limit)
    base = base_fit(take, hypothesis, first_scales(take), assumed)
    while integration_step(base.car()) < take.h:  # it is stiffer than the car before
        take, hits = prepared(recordings, estimates, base.car(), hypothesis.angle_limit)
        known = list(base.hypothesis.values(base.phi).values())
        base = base_fit(take, replace(hypothesis, nominal=base.car()), first_scales(take), known)
    return take, hits, base


def too_bent(fit: Fit, take: Take) -> bool:
    """Whether predictions miss the fit's tangent by so much that they have to be made under pushes."""
    setting = fit.hypothesis.setting(fit.phi, take)
    return not take.pushed and bent(take, setting, fit.start, fit.scales, fit.tangent.A) > MOST_BENT


def under_pushes(take: Take, base: Fit) -> tuple[Take, Fit]:
    """The take with predictions to be made under the likeliest pushes, and the base model's fit made so.

    Raises:
        FloatingPointError: when the base model cannot follow it.
    """
    take, h = take._replace(pushed=True), base.hypothesis
    known = list(h.values(base.phi).values())
    return take, base_fit(take, replace(h, nominal=base.car()), base.scales, known)


def suited(take: Take, base: Fit) -> tuple[Take, Fit]:
    """The same `under_pushes` where it is too bent without.

    Raises:
        FloatingPointError: when the base model cannot follow it.
    """
    return under_pushes(take, base) if too_bent(base, take) else (take, base)


def first_scales(take: Take) -> Scales:
    """Noise from the scatter of neighbouring poses, and a push to begin with."""
    second = np.concatenate(
        [np.diff(take.pose[a:b], 2, axis=0) for a, b in zip(take.first, take.first[1:], strict=False)]
    )
    r = 1.4826 * np.median(np.abs(second), axis=0) / np.sqrt(6.0)
    return Scales(np.maximum(r, 1e-6), np.full(3, FIRST_PUSH))


GRIPS = (2.0, 8.0)  # N/kg


ENOUGH = 100  # segments on which starts are compared


LOST = 5.0  # nats per segment: a refit to the whole that is worth so much less than that of the part (94 were seen)


def base_fit(take: Take, hypothesis: Hypothesis, scales: Scales, assumed: Sequence[float] = ()) -> Fit:
    """The base model refitted to the take, with what it assumes from the values `assumed`.

    From the nominal car, which may be far off where it comes from one-step predictions, and from cars with usual
    tyres that slide or do not: grip that is never reached has no slope.  The best of them on a part of the take is
    refitted to the whole; where that leads astray, from other scales and from the next best, and the best of them is
    taken where all do.  Of a take so short that the part is all of it either fit will do: the better one, or the one
    that there is.  A trusted simulation is its own only start.

    Raises:
        FloatingPointError: when none stays within the finite numbers.
    """
    base, nominal = hypothesis.holding(), hypothesis.nominal
    chosen = np.arange(0, take.segments, max(1, take.segments // ENOUGH))
    part, fits, error = take.part(chosen), list[Fit](), FloatingPointError()
    usual = [with_usual_tyres(nominal, grip) for grip in GRIPS]
    if "d" in hypothesis.unknown_steering:  # a servo may have no limit that shows
        usual = [car._replace(d=max(car.d, 2.0 * hypothesis.angle_limit / car.T_s)) for car in usual]
    for car in (nominal, *usual) if hypothesis.simulated is None else (nominal,):
        try:
            fits.append(refit(part, base, base.start(car, assumed), part.start, scales))
        except FloatingPointError as failed:
            error = failed
    astray, short = list[Fit](), part.segments == take.segments
    for fit in sorted(fits, key=lambda f: -f.bic):
        for begun in (fit.scales, scales):
            try:
                whole = refit(take, base, fit.phi, take.start, begun)
            except FloatingPointError as failed:
                error = failed
                continue
            if short:
                return max(fit, whole, key=lambda f: f.bic)
            if whole.per_segment.mean() > fit.per_segment.mean() - LOST:
                return whole
            astray.append(whole)
        if short:
            return fit
    if astray:
        return max(astray, key=lambda f: f.bic)
    raise error
