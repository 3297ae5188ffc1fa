"""A diagnosis from a recording and its estimate: everything in order, nothing of it on disk."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from threadpoolctl import threadpool_limits

from bcid.diagnosis.base_fit import base_fit
from bcid.diagnosis.contacts import Contact, contacts, without_contacts
from bcid.diagnosis.disturbance import Disturbances, disturbances
from bcid.diagnosis.excitation import Unexcited, unexcited
from bcid.diagnosis.hypothesis import Hypothesis
from bcid.diagnosis.locate import Location, located
from bcid.diagnosis.marginal import Scales
from bcid.diagnosis.refit import Fit, held
from bcid.diagnosis.remainder import remainder
from bcid.diagnosis.search import Search, search
from bcid.diagnosis.take import Take, joined, moving, take_of
from bcid.diagnosis.verdict import Judgement, judged
from bcid.effects.constants import Constants
from bcid.effects.corrections import RAW_COMMANDS
from bcid.effects.entry import Units
from bcid.effects.table import ENTRIES
from bcid.errors import InputRefused
from bcid.estimate.types import Estimate
from bcid.models.newton_euler_start import started_car
from bcid.physics.car import Car, integration_step
from bcid.recording.types import Recording
from bcid.vehicle import Vehicle


class _Yardstick(NamedTuple):
    mass_kg: float
    length_m: float
    speed_mps: float


BUMPER_CAR = _Yardstick(319.6, 0.87, 1.9)
FEWEST_SEGMENTS = 20
SMALLEST_P = 1e-3  # that is claimed: the null takes drawn are about a thousand
FIRST_PUSH = 0.05  # m/s^2 and rad/s^2: where the search for the pushes' scale begins

Progress = Callable[[float, str], None]


@dataclass(frozen=True)
class Diagnosis:
    """What was found, and what it was found with."""

    take: Take
    contacts: tuple[Contact, ...]
    search: Search
    judgement: Judgement
    location: Location
    before: Disturbances  # under the refitted base model
    after: Disturbances  # under the fit with what was found
    unexcited: tuple[Unexcited, ...]

    @property
    def p_value(self) -> float:
        """That nothing is missing: of all effects, places, times and the base model's simplifications (Bonferroni)."""
        from scipy.stats import chi2

        found, location = self.search, self.location
        free = len(found.corrected.hypothesis.parameters) - len(found.base.hypothesis.parameters)
        gained = found.corrected.log_likelihood - found.base.log_likelihood
        simplified = float(chi2.sf(2.0 * gained, free)) if free else 1.0
        smallest = min(found.p_value, location.place_p, location.window_p, simplified)
        return min(1.0, 4.0 * max(smallest, SMALLEST_P))


def constants_of(vehicle: Vehicle) -> Constants:
    """The effects' held constants."""
    track = vehicle.body.rear_track_m
    return Constants() if track is None else Constants(track=track)


def units_of(car: Car, estimates: Sequence[Estimate]) -> Units:
    """The vehicle against the bumper car, for which sizes are declared: mass, wheelbase, time to drive a wheelbase."""
    length = (car.l_f + car.l_r) / BUMPER_CAR.length_m
    speed = float(np.quantile(np.abs(np.concatenate([e.kinematic[:, 0] for e in estimates])), 0.9))
    return Units(car.m / BUMPER_CAR.mass_kg, length, length * BUMPER_CAR.speed_mps / max(speed, 0.05))


def prepared(
    recordings: Sequence[Recording], estimates: Sequence[Estimate], car: Car
) -> tuple[Take, tuple[Contact, ...]]:
    """The recordings as one take without contacts and without what stands still, for steps that suit the car.

    Raises:
        InputRefused: when too little of it can be used.
    """
    parts, hits = [], []
    for recording, estimate in zip(recordings, estimates, strict=True):
        found = contacts(recording)
        hits += found
        take = moving(without_contacts(take_of(recording, estimate, integration_step(car)), found), car.l_f + car.l_r)
        if take.segments < FEWEST_SEGMENTS:
            raise InputRefused(
                recording.sources[0].path, "poses",
                f"only {take.segments} stretches of 1.5 s in motion can be used, {FEWEST_SEGMENTS} are the least",
                "record a longer take with fewer gaps",
            )  # fmt: skip
        parts.append(take)
    return joined(parts), tuple(hits)


class Compared(NamedTuple):
    """The simulation that a recording is compared with, as a car and the effects that it has."""

    car: Car
    effects: dict[str, float]  # by field of the switches
    trust: float | None = None  # relative standard deviation of all that; None to refit it freely

    def assumed(self) -> tuple[str, ...]:
        """The effects' ids."""
        return effects_of(self.effects)


def effects_of(fields: Iterable[str]) -> tuple[str, ...]:
    """The ids of the effects with these fields among the switches."""
    return tuple(dict.fromkeys(field.partition("__")[0] for field in fields))


def base_of(vehicle: Vehicle, car: Car, estimates: Sequence[Estimate], assumed: tuple[str, ...] = ()) -> Hypothesis:
    """The base model of a vehicle about `car`, with what it assumes."""
    steering = vehicle.steering
    unknown = tuple(
        s for s, given in (("T_s", steering.time_constant_s), ("d", steering.max_rate_radps)) if given is None
    )
    return Hypothesis(
        (), car, steering.max_angle_rad, constants_of(vehicle), unknown, units_of(car, estimates), assumed,
        vehicle.raw_steering,
    )  # fmt: skip


def diagnosed(
    recordings: Sequence[Recording], estimates: Sequence[Estimate], vehicle: Vehicle,
    simulation: Compared | None = None, progress: Progress = lambda share, text: None, left_out: Sequence[str] = (),
) -> Diagnosis:  # fmt: skip
    """What the recordings show beside the Newton-Euler model, or beside what `simulation` has.

    The base model is refitted, from the simulation's car where one is given.  Effects in `left_out` are not
    considered.

    Raises:
        InputRefused: when too little of the recordings can be used.
    """
    facts = estimates[0].facts
    progress(0.02, "a first car")
    car = simulation.car if simulation else started_car(estimates, vehicle, facts["T_s"], facts["d"])._replace(u_0=0.0)
    assumed = dict(simulation.effects) if simulation else {}
    if vehicle.raw_steering:  # its gain belongs to the base model
        assumed = {field: 0.0 for name in RAW_COMMANDS for field in ENTRIES[name].fields} | assumed
    hypothesis = base_of(vehicle, car, estimates, effects_of(assumed))
    values = list(assumed.values())
    if simulation and simulation.trust is not None:
        hypothesis = hypothesis.trusting(values, simulation.trust)
    with threadpool_limits(1, "blas"):  # the kernels share the cores; BLAS on small matrices would fight for them
        try:
            progress(0.05, "the base model")
            take, hits, base = _base(recordings, estimates, hypothesis, values)
            given = None
            if simulation and simulation.trust is None:
                with suppress(FloatingPointError):  # as it is it may not drive this take at all
                    given = held(take, base.hypothesis, base.hypothesis.start(car, values), base.scales)
            return _of_take(take, base, given, hits, progress, left_out)
        except (FloatingPointError, np.linalg.LinAlgError) as error:
            raise InputRefused(
                recordings[0].sources[0].path,
                "poses and commands",
                f"the model cannot follow them: {error}",
                "check the vehicle file's mass, distances and limits, and the recording's units",
            ) from error


def _base(
    recordings: Sequence[Recording], estimates: Sequence[Estimate], hypothesis: Hypothesis, assumed: Sequence[float]
) -> tuple[Take, tuple[Contact, ...], Fit]:
    """The take, its contacts and the base model's fit, in steps that the fitted car bears."""
    take, hits = prepared(recordings, estimates, hypothesis.nominal)
    base = base_fit(take, hypothesis, first_scales(take), assumed)
    while integration_step(base.car()) < take.h:  # it is stiffer than the car before
        take, hits = prepared(recordings, estimates, base.car())
        known = list(base.hypothesis.values(base.phi).values())
        base = base_fit(take, replace(hypothesis, nominal=base.car()), first_scales(take), known)
    return take, hits, base


def _of_take(
    take: Take, base: Fit, given: Fit | None, hits: tuple[Contact, ...], progress: Progress, left_out: Sequence[str]
) -> Diagnosis:
    progress(0.15, "where the mismatch is")
    before = disturbances(base, take)
    whole = remainder(before, base.car())
    location = located(base, take, before, whole)
    found = search(base, take, whole, lambda text: progress(0.3, text), left_out, given)
    progress(0.8, "what is left")
    judgement = judged(found, take, location.place, whole if found.best is base else None)
    after = disturbances(judgement.fit, take)
    not_seen = unexcited(judgement.fit, take, found.trials, found.nulls.gate)
    return Diagnosis(take, hits, found, judgement, location, before, after, not_seen)


def first_scales(take: Take) -> Scales:
    """Noise from the scatter of neighbouring poses, and a push to begin with."""
    second = np.concatenate(
        [np.diff(take.pose[a:b], 2, axis=0) for a, b in zip(take.first, take.first[1:], strict=False)]
    )
    r = 1.4826 * np.median(np.abs(second), axis=0) / np.sqrt(6.0)
    return Scales(np.maximum(r, 1e-6), np.full(3, FIRST_PUSH))
