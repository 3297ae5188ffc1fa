"""A hypothesis: which effects are there; and its parameters as one vector beside the base model's."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from bcid.aliases import Floats
from bcid.effects.constants import Constants
from bcid.effects.corrections import FORCE_ONLY, RAW_COMMANDS
from bcid.effects.entry import Effect, Parameter, Units, resized
from bcid.effects.motion import Chain, steering_chain
from bcid.effects.table import ENTRIES, switches
from bcid.likelihood.predict import half_steps
from bcid.likelihood.take import Take
from bcid.physics.car import Car, integration_step

TYRES = ("I_z", "C_f", "C_r", "F_f_max", "F_r_max")
SPEED_LAW = ("F_m_max", "K_t", "K_b")
FORCE_LAW = ("K_t", "K_v", "K_b")
"""Refitted with every effect, as logarithms (specification); m, l_f, l_r, c and v_0 are held.

So is the throttle u_0 from which a force begins: what it lacks is `motor_dead_zone`.
"""

DRAG = ("R_1", "R_2")
"""Refitted too, in units of their own (`Hypothesis.drag_units`), since they may have either sign."""

INERTIA, STIFFNESS = 5.0, 100.0  # times two masses over the axles, and N/rad per kg: either way, no car is beyond
BUMPER_CAR_LOCK = 2.012  # rad, for which a steering's cubic part is declared
FORCE_DEAD_ZONE = 0.1  # of the throttle
MEASURED = 0.5  # of how far a tracked point may be from where it was thought, where somebody has measured that
DRAG_UNIT = 0.1  # of the mass, per second and per metre, of the bumper car
PRIOR_SD = 1.5  # of the logarithms and of the drag in its units: weak, for what the take does not show
NEAR_BOUND = 1e-3  # of phi
TRUSTED = 3.0  # standard deviations from a simulation's parameter beyond which it is not: something else is missing


ON_THE_CHAIN = (
    "steering_backlash__b", "steering_dead_band__b", "steering_delay__tau", "steering_lag__tau",
    "steering_rate_asymmetry__a", "motor_delay__tau", "pose_latency__tau", "clock_drift__rho",
)  # fmt: skip
"""The switches that the actuator chain knows; the others leave it as it is."""

KEPT_CHAINS = 4
_KNOWN: dict[Any, tuple[tuple[Floats, ...], Chain]] = {}  # the commands are held, so that their ids stay theirs


BUMPER_CAR = Units()


class Setting(NamedTuple):
    """All that a prediction needs beside initial states."""

    car: Car
    switches: Any
    chain: Chain
    constants: Constants

    @property
    def acting(self) -> tuple[Chain, Car, Any, Constants]:
        """As the kernels over all segments take it."""
        return self.chain, self.car, self.switches.reshape(1), self.constants


class Simulated(NamedTuple):
    """A simulation's own parameters, as far as they are trusted."""

    phi: tuple[float, ...]
    sd: tuple[float, ...]
    free: tuple[str, ...] = ()  # of `names`, what it knows nothing of
    share: float = 1.0  # of the take that is fitted, which bends them as far as the whole does


@dataclass(frozen=True)
class Hypothesis:
    """The base model and some effects.

    The vector phi holds the logarithms of `logs`, DRAG in its units, then the effects' parameters in units
    of their sizes (places and times in metres and seconds).
    """

    effects: tuple[str, ...]
    nominal: Car
    angle_limit: float
    constants: Constants
    unknown_steering: tuple[str, ...] = ()  # of T_s and d, what the vehicle file omits: refitted as well
    units: Units = BUMPER_CAR  # of the vehicle, against the bumper car
    assumed: tuple[str, ...] = ()  # effects that the simulation to compare with has: part of the base model
    raw_commands: bool = False  # in units of their own, which a gain in the vehicle file turns into rad
    simulated: Simulated | None = None  # what a simulation knows of the base model and what is assumed
    measured_point: bool = False  # whether the vehicle file says where on the car the tracked point is

    @cached_property
    def entries(self) -> dict[str, Effect]:
        """All that can be fitted, with sizes as they suit the vehicle."""
        known = {name: resized(e, self.units) for name, e in ENTRIES.items()}
        bend = known["steering_nonlinearity"]  # as large a share of the angle at this vehicle's full lock
        share = (BUMPER_CAR_LOCK / self.angle_limit) ** 2
        known["steering_nonlinearity"] = replace(bend, parameters=tuple(p.times(share) for p in bend.parameters))
        if self.nominal.sets_force > 0.0:  # a throttle without unit, and no reference above which to brake
            zone = known["motor_dead_zone"]
            width = zone.parameters[0]._replace(unit="1", high=1.0, size=FORCE_DEAD_ZONE)
            known["motor_dead_zone"] = replace(zone, parameters=(width,))
            del known["motor_regeneration"]
        else:
            del known[FORCE_ONLY]
        if self.nominal.front_share == 0.0:  # a front wheel that is not driven spends no grip on it
            del known["friction_circle"]
        if not self.raw_commands:
            for name in RAW_COMMANDS:
                del known[name]
        if self.measured_point:
            point = known["marker_offset"]
            near = tuple(p._replace(low=MEASURED * p.low, high=MEASURED * p.high) for p in point.parameters)
            known["marker_offset"] = replace(point, parameters=near)
        return known

    @cached_property
    def step_s(self) -> float:
        """Integration step."""
        return integration_step(self.nominal)

    @property
    def logs(self) -> tuple[str, ...]:
        """The base parameters that phi holds as logarithms."""
        return (*(FORCE_LAW if self.nominal.sets_force > 0.0 else SPEED_LAW), *TYRES, *self.unknown_steering)

    @property
    def drag_units(self) -> Floats:
        """What one unit of DRAG in phi is (N s/m, N s^2/m^2), as it suits the vehicle."""
        return DRAG_UNIT * self.nominal.m / np.array([self.units.s, self.units.m])

    @property
    def base_size(self) -> int:
        """How many of phi belong to the base model."""
        return len(self.logs) + len(DRAG)

    def holding(self, *effects: str) -> Hypothesis:
        """The same base model, and what it assumes, with these effects."""
        return replace(self, effects=(*self.assumed, *(e for e in effects if e not in self.assumed)))

    def with_effect(self, name: str, phi: Floats, values: Sequence[float]) -> tuple[Hypothesis, Floats]:
        """The hypothesis with one effect more at `values`, and phi where that of all else is `phi`."""
        more = self.holding(*self.effects, name)
        return more, np.array([*phi, *(np.array(values) / more.sizes()[len(phi) - self.base_size :])])

    @property
    def parameters(self) -> list[tuple[str, Parameter]]:
        """Field among the switches and declaration of each effect parameter."""
        return [
            pair
            for name in self.effects
            for pair in zip(self.entries[name].fields, self.entries[name].parameters, strict=True)
        ]

    @property
    def size(self) -> int:
        """Length of phi."""
        return self.base_size + len(self.parameters)

    @property
    def names(self) -> list[str]:
        """Of all of phi: the base model's symbols, and the effects' ids once for each of their parameters."""
        return [*self.logs, *DRAG, *(field.partition("__")[0] for field, _ in self.parameters)]

    @property
    def placed(self) -> npt.NDArray[np.bool_]:
        """Which of phi are places or times."""
        return np.array([False] * self.base_size + [p.places for _, p in self.parameters])

    def sizes(self) -> Floats:
        """What one unit of each effect parameter in phi is."""
        return np.array([1.0 if p.places else p.size for _, p in self.parameters])

    def start(self, car: Car, values: Sequence[float] = ()) -> Floats:
        """Phi of `car` with the effects' parameters at `values` (off unless given)."""
        given = list(values) or [p.off for _, p in self.parameters]
        logs = [np.log(getattr(car, s)) for s in self.logs]
        drags = np.array([getattr(car, s) for s in DRAG]) / self.drag_units
        return np.array([*logs, *drags, *(np.array(given) / self.sizes())])

    def prior(self, start: Floats) -> tuple[Floats, Floats]:
        """Centre and stiffness (1 / variance) of phi: the simulation's own if it is trusted, else weak about `start`.

        Of effects that nothing assumes, there is none.
        """
        centre, stiffness = start.copy(), np.zeros(self.size)
        if self.simulated is None:
            stiffness[: self.base_size] = 1.0 / PRIOR_SD**2
        else:
            n = len(self.simulated.phi)
            centre[:n], stiffness[:n] = self.simulated.phi, self.simulated.share / np.array(self.simulated.sd) ** 2
        return centre, stiffness

    def trusting(
        self, values: Sequence[float], relative: float, of: Mapping[str, float] = MappingProxyType({})
    ) -> Hypothesis:
        """The same where the nominal car and the `values` of what is assumed are known as well as `relative` says.

        Or as `of` says of a parameter of the base model or of an effect by its name.  What is nothing in the simulation
        is known as well as that share of its unit; a gain that turns raw commands into angles belongs to no simulation,
        and stays as free as it is where `of` does not say how well it was measured.
        """
        centre, names = self.holding().start(self.nominal, values), np.array(self.holding().names)
        sd = np.array([of.get(name, relative) for name in names])  # of a logarithm it is relative as it stands
        sd[len(self.logs) :] *= np.maximum(np.abs(centre[len(self.logs) :]), 1.0)
        free = tuple(name for name in RAW_COMMANDS if name not in of)
        for name in np.intersect1d(RAW_COMMANDS, names).tolist():
            sd[names == name] = of[name] / self.entries[name].parameters[0].size if name in of else PRIOR_SD
        return replace(self, simulated=Simulated(tuple(centre.tolist()), tuple(sd.tolist()), free))

    def of_a_share(self, share: float) -> Hypothesis:
        """The same for a share of a take, which bends a simulation's parameters as far as the whole does."""
        return self if self.simulated is None else replace(self, simulated=self.simulated._replace(share=share))

    def bounds(self) -> tuple[Floats, Floats]:
        """Lowest and highest phi: where no car is beyond (`usual_bounds`), and none that a trusted simulation knows.

        A motor a quarter weaker than it is known to be does what a friction does, at the price of a few nats by its
        prior, where a drive of minutes tells by hundreds.
        """
        low, high = self.usual_bounds()
        if self.simulated is not None:
            known, centre = slice(len(self.simulated.phi)), np.array(self.simulated.phi)
            free = np.isin(self.names[known], self.simulated.free)
            reach = np.where(free, np.inf, TRUSTED * np.array(self.simulated.sd))
            low[known] = np.maximum(low[known], centre - reach)
            high[known] = np.minimum(high[known], centre + reach)
        return low, high

    def usual_bounds(self) -> tuple[Floats, Floats]:
        """Lowest and highest phi of any car.

        A fit without what is missing runs away with them: a tyre of endless stiffness and hardly any grip, say,
        does what a drag does that grows with the steering.
        """
        n, car = self.base_size, self.nominal
        inertia = car.m * car.l_f * car.l_r
        low, high = np.full(n, -np.inf), np.full(n, np.inf)
        for symbol, usual, times in (("I_z", inertia, INERTIA), ("C_f", car.m, STIFFNESS), ("C_r", car.m, STIFFNESS)):
            k = self.logs.index(symbol)
            low[k] = min(np.log(usual / times), np.log(getattr(car, symbol)))
            high[k] = max(np.log(usual * times), np.log(getattr(car, symbol)))
        own_low = [p.low / u for (_, p), u in zip(self.parameters, self.sizes(), strict=True)]
        own_high = [p.high / u for (_, p), u in zip(self.parameters, self.sizes(), strict=True)]
        return np.r_[low, own_low], np.r_[high, own_high]

    def at_bound(self, phi: Floats) -> npt.NDArray[np.bool_]:
        """Which of phi are at an end of their `bounds`, as near as refits end."""
        low, high = self.bounds()
        return np.asarray(np.minimum(phi - low, high - phi) < NEAR_BOUND)

    def values(self, phi: Floats) -> dict[str, float]:
        """The effects' parameters by field."""
        raw = phi[self.base_size :] * self.sizes()
        return dict(zip((f for f, _ in self.parameters), raw.tolist(), strict=True))

    def car(self, phi: Floats) -> Car:
        """The base parameters."""
        logs = dict(zip(self.logs, np.exp(phi[: len(self.logs)]).tolist(), strict=True))
        drags = phi[len(self.logs) : self.base_size] * self.drag_units
        return self.nominal._replace(**logs, **dict(zip(DRAG, drags.tolist(), strict=True)))

    def setting(self, phi: Floats, take: Take) -> Setting:
        """The car, the switches and the actuator chain at phi."""
        car = self.car(phi)
        e = switches(self.values(phi))
        return Setting(car, e, _chain(take, car, self.angle_limit, e), self.constants)


def _chain(take: Take, car: Car, limit: float, switches: Any) -> Chain:
    """The actuator chain, from the last few found where the effects on it are the same.

    A late pose, or one on a fast clock, is the same as commands that come that much later: the chain
    runs on the poses' clock.
    """
    acting = tuple(getattr(switches, name) for name in ON_THE_CHAIN)
    key = (id(take.command_s), id(take.command_zero_s), id(take.command), take.T, take.h, car.T_s, car.d, limit, acting)
    if key not in _KNOWN:
        zero = take.command_zero_s
        times = zero + (take.command_s - zero + switches.pose_latency__tau) * (1.0 + switches.clock_drift__rho)
        chain = steering_chain(times, take.command, 0.0, half_steps(take.T, take.h), take.h, car, limit, switches)
        if len(_KNOWN) >= KEPT_CHAINS:
            _KNOWN.pop(next(iter(_KNOWN)))
        _KNOWN[key] = ((take.command_s, take.command_zero_s, take.command), chain)
    return _KNOWN[key][1]
