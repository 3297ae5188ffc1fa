"""A hypothesis: the base model with a set of effects, and the parameters of both as one vector phi."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from bcid.aliases import Bools, Floats
from bcid.effects.constants import Constants
from bcid.effects.corrections import MEASURED_SPEED, RAW_COMMANDS
from bcid.effects.entry import Effect, Parameter, VehicleScale, resize_effect
from bcid.effects.table import ENTRIES, effect_switches
from bcid.likelihood.limits import LIKELIHOOD_LIMITS
from bcid.likelihood.prediction_inputs import PredictionInputs, cached_actuator_chain
from bcid.likelihood.prior import TRUST_NU, Prior
from bcid.likelihood.take import Take
from bcid.likelihood.unnamed_functions import NO_REMAINDER, NO_UNNAMED, RemainderFunctions, UnnamedFunctions
from bcid.physics.car import FASTEST_FOLLOWING_S, Car

TYRES = ("I_z", "C_f", "C_r", "F_f_max", "F_r_max")
SPEED_LAW = ("F_m_max", "K_t", "K_b")
FORCE_LAW = ("K_t", "K_v", "K_b")
FOLLOWING_LAW = ("K_t",)
"""Base parameters that every refit moves, as logarithms (specification); m, l_f, l_r, c and v_0 are held.

The throttle u_0 from which a force begins is held, too: what it lacks is the effect `motor_dead_zone`.  A wheel whose
measured speed is followed drives and brakes by the one K_t, and reaches no F_m_max of its own.
"""

MOTOR_LAWS = {"speed": SPEED_LAW, "force": FORCE_LAW, "measured-speed": FOLLOWING_LAW}
"""Base parameters of the motor that every refit moves, by the vehicle file's law."""

NEEDS_THROTTLE = (
    "motor_delay", "motor_lag", "motor_dead_zone", "motor_sag", "motor_power_limit", "motor_regeneration", "motor_fade",
)  # fmt: skip
"""Effects of a motor that is told what to do: a measured wheel speed holds all of them already."""

USUAL_FOLLOWING_S = math.sqrt(10.0) * FASTEST_FOLLOWING_S
"""Time (s) within which a vehicle follows its driven wheel's speed, m/K: 0.03.

A tyre's force by its slip ratio is 10 to 30 times its load, so that K is 10 to 30 g m/v with all weight on the driven
wheel: 0.003 to 0.01 s at 1 m/s, a few times as much with a third of the weight and an encoder that counts for a while.
"""

DRAG = ("R_1", "R_2")
"""Base parameters that every refit moves, in `Hypothesis.drag_units`, since they may have either sign."""

BUMPER_CAR_LOCK = 2.012  # full lock (rad) of the car for which a steering's cubic part is declared
FORCE_DEAD_ZONE = 0.1  # declared size of `motor_dead_zone` as a share of a throttle that sets a force
DRAG_UNIT = 0.1  # unit of R_1 and R_2 in phi: share of the bumper car's mass, per second and per metre
BUMPER_CAR_SCALE = VehicleScale()


def motor_parameters(car: Car) -> tuple[str, ...]:
    """Symbols of the base parameters of a car's motor that every refit moves, by what its throttle is."""
    if car.follows_wheel > 0.0:
        return FOLLOWING_LAW
    return FORCE_LAW if car.sets_force > 0.0 else SPEED_LAW


class TrustedSimulation(NamedTuple):
    """A simulation's parameters and how well they are known: a prior of the base model and the assumed effects."""

    phi: tuple[float, ...]
    sd: tuple[float, ...]  # scales of the parameters' laws, of which far values are more likely than of a normal one
    share: float = 1.0  # by which the prior counts where only this share of a take is fitted
    nu: float = TRUST_NU  # degrees of freedom of the laws


@dataclass(frozen=True)
class Hypothesis:
    """The base model with a set of effects, whose parameters form one vector phi.

    phi holds the logarithms of `log_parameters`, R_1 and R_2 in `drag_units`, the effects' parameters in `effect_units`
    (their declared sizes, and metres or seconds for places and times), then the remainder's coefficients over their
    prior standard deviations.
    """

    effects: tuple[str, ...]
    nominal: Car
    angle_limit: float
    constants: Constants
    unknown_steering: tuple[str, ...] = ()  # those of T_s and d that the vehicle file omits: refitted as well
    units: VehicleScale = BUMPER_CAR_SCALE  # the vehicle's mass, length and time over the bumper car's
    assumed: tuple[str, ...] = ()  # effects of the simulation to compare with: part of the base model
    raw_commands: bool = False  # commands have a unit of their own, which a gain in the vehicle file turns into rad
    trusted_simulation: TrustedSimulation | None = None
    measured_point: bool = False  # the vehicle file says where on the car the tracked point is
    remainder: RemainderFunctions = field(default=NO_REMAINDER, compare=False)
    known: UnnamedFunctions = field(default=NO_UNNAMED, compare=False)  # of the simulation: part of the base model

    @cached_property
    def entries(self) -> dict[str, Effect]:
        """All effects and corrections that can be fitted to this vehicle, by id, with sizes and bounds that suit it."""
        known = {name: resize_effect(e, self.units) for name, e in ENTRIES.items()}
        # the cubic part is as large a share of the angle at this vehicle's full lock
        bend, share = known["steering_nonlinearity"], (BUMPER_CAR_LOCK / self.angle_limit) ** 2
        known["steering_nonlinearity"] = replace(bend, parameters=tuple(p.scale(share) for p in bend.parameters))
        if self.nominal.sets_force > 0.0:  # a throttle without unit, and no reference above which to brake
            zone = known["motor_dead_zone"]
            width = zone.parameters[0]._replace(unit="1", high=1.0, size=FORCE_DEAD_ZONE)
            known["motor_dead_zone"] = replace(zone, parameters=(width,))
            del known["motor_regeneration"]
        else:
            del known["motor_fade"]
        for name in NEEDS_THROTTLE if self.nominal.follows_wheel > 0.0 else MEASURED_SPEED:
            known.pop(name, None)
        if self.nominal.front_share == 0.0:  # a front wheel that is not driven spends no grip on it
            del known["friction_circle"]
        if not self.raw_commands:
            for name in RAW_COMMANDS:
                del known[name]
        if self.measured_point:
            point, share = known["marker_offset"], LIKELIHOOD_LIMITS.measured_marker_share
            near = tuple(p._replace(low=share * p.low, high=share * p.high) for p in point.parameters)
            known["marker_offset"] = replace(point, parameters=near)
        return known

    @property
    def log_parameters(self) -> tuple[str, ...]:
        """Symbols of the base parameters that the parameter vector phi holds as logarithms, in its order."""
        return (*motor_parameters(self.nominal), *TYRES, *self.unknown_steering)

    @property
    def drag_units(self) -> Floats:
        """Values (2,) of R_1 (N s/m) and R_2 (N s^2/m^2) that are 1 in the parameter vector phi."""
        return DRAG_UNIT * self.nominal.m / np.array([self.units.s, self.units.m])

    @property
    def base_size(self) -> int:
        """Number of parameters of the base model, which come first in the parameter vector phi."""
        return len(self.log_parameters) + len(DRAG)

    def with_effects(self, *effects: str) -> Hypothesis:
        """The hypothesis with the assumed effects and `effects` in the place of the present ones."""
        return replace(self, effects=(*self.assumed, *(e for e in effects if e not in self.assumed)))

    def add_effect(self, name: str, phi: Floats, values: Sequence[float]) -> tuple[Hypothesis, Floats]:
        """The hypothesis with effect `name` added, and its parameter vector: `phi`, then the effect's `values` (SI)."""
        more, end = self.with_effects(*self.effects, name), self.named_size
        return more, np.array(
            [*phi[:end], *(np.array(values) / more.effect_units()[end - self.base_size :]), *phi[end:]]
        )

    @property
    def effect_parameters(self) -> list[tuple[str, Parameter]]:
        """Name of the field among the switches, and declaration, of each effect parameter in the order of phi."""
        entries = [self.entries[name] for name in self.effects]
        return [pair for e in entries for pair in zip(e.fields, e.parameters, strict=True)]

    @property
    def named_size(self) -> int:
        """Number of parameters that have a name: those of the base model and the effects, which come first in phi."""
        return self.base_size + len(self.effect_parameters)

    @property
    def size(self) -> int:
        """Number of parameters of the hypothesis: the length of its vector phi."""
        return self.named_size + len(self.remainder.sd)

    @property
    def parameter_names(self) -> list[str]:
        """A name for each component of the parameter vector phi: the base model's symbol, or the effect's id."""
        effects = (name.partition("__")[0] for name, _ in self.effect_parameters)
        return [*self.log_parameters, *DRAG, *effects, *self.remainder.channel]

    @property
    def is_place(self) -> Bools:
        """Mask of the parameter vector phi: True where a component is a place or a time."""
        own = [p.is_place for _, p in self.effect_parameters]
        return np.array([*[False] * self.base_size, *own, *[False] * len(self.remainder.sd)])

    def is_off(self, phi: Floats) -> Bools:
        """Mask of the parameter vector phi: True where an effect's parameter is where the effect does nothing."""
        off = np.array([p.off for _, p in self.effect_parameters]) / self.effect_units()
        own = phi[self.base_size : self.named_size] == off
        return np.array([*[False] * self.base_size, *own, *[False] * len(self.remainder.sd)])

    def effect_units(self) -> Floats:
        """Values (SI) of the effect parameters that are 1 in the parameter vector phi."""
        return np.array([1.0 if p.is_place else p.size for _, p in self.effect_parameters])

    def units_at(self, phi: Floats) -> Floats:
        """What a unit of each component of phi but the remainder's is in SI units, to first order at phi."""
        car = self.car(phi)
        return np.array([*(getattr(car, s) for s in self.log_parameters), *self.drag_units, *self.effect_units()])

    def phi_of(self, car: Car, values: Sequence[float] = ()) -> Floats:
        """The parameter vector phi of `car` with the effects' parameters at `values` (SI; all off where empty).

        The remainder's coefficients are zero.
        """
        given = list(values) or [p.off for _, p in self.effect_parameters]
        logs = [np.log(getattr(car, s)) for s in self.log_parameters]
        drags = np.array([getattr(car, s) for s in DRAG]) / self.drag_units
        return np.array([*logs, *drags, *(np.array(given) / self.effect_units()), *np.zeros(len(self.remainder.sd))])

    def phi_at(self, car: Car, values: Mapping[str, float]) -> Floats:
        """The parameter vector phi of `car` and of effects' parameters (SI) by field; those without a value are off."""
        return self.phi_of(car, [values.get(field, p.off) for field, p in self.effect_parameters])

    def begin_at(self, factors: Mapping[str, float]) -> Hypothesis:
        """The hypothesis with another nominal car, from which fits begin; what a simulation is trusted for stays.

        Of its `factors` those of base parameters that are fitted count.
        """
        fitted = {*self.log_parameters, *DRAG} & factors.keys()
        return replace(
            self, nominal=self.nominal._replace(**{s: factors[s] * getattr(self.nominal, s) for s in fitted})
        )

    def prior(self, start: Floats) -> Prior:
        """The prior of the parameter vector phi: a trusted simulation's, or a weak one about `start`.

        Effects that are not assumed have none.
        """
        centre, precision, trusted = start.copy(), np.zeros(self.size), self.trusted_simulation
        nu, share = np.full(self.size, np.inf), np.ones(self.size)
        if trusted is None:
            precision[: self.base_size] = 1.0 / LIKELIHOOD_LIMITS.base_prior_sd**2
        else:
            known = slice(len(trusted.phi))
            centre[known], precision[known] = trusted.phi, np.array(trusted.sd) ** -2.0
            nu[known], share[known] = trusted.nu, trusted.share
        centre[self.named_size :], precision[self.named_size :] = 0.0, 1.0
        return Prior(centre, precision, nu, share)

    def trust_simulation(
        self, values: Sequence[float], relative_sd: float, known_sd: Mapping[str, float] = MappingProxyType({})
    ) -> Hypothesis:
        """The hypothesis with a prior about the nominal car and the `values` (SI) of the assumed effects.

        Parameters that are zero in the simulation are known to that share of their unit.  A gain that turns raw
        commands into angles belongs to no simulation: it stays free unless `known_sd` says how well it was measured.

        Args:
            values: parameters of the assumed effects, in their order.
            relative_sd: scale of the law of every parameter (`prior.py`), as a share of its value.
            known_sd: the same share for single parameters, by the base model's symbol or the effect's id.
        """
        base = self.with_effects()
        centre, names = base.phi_of(self.nominal, values), np.array(base.parameter_names)
        sd = np.array([known_sd.get(name, relative_sd) for name in names])  # of a logarithm it is relative as it stands
        sd[len(self.log_parameters) :] *= np.maximum(np.abs(centre[len(self.log_parameters) :]), 1.0)
        for name in np.intersect1d(RAW_COMMANDS, names).tolist():
            sd[names == name] = (
                known_sd[name] / self.entries[name].parameters[0].size
                if name in known_sd
                else LIKELIHOOD_LIMITS.base_prior_sd
            )
        return replace(self, trusted_simulation=TrustedSimulation(tuple(centre.tolist()), tuple(sd.tolist())))

    def scale_simulation_prior(self, share: float) -> Hypothesis:
        """The hypothesis for a `share` of a take, which moves a simulation's parameters as far as the whole does."""
        trusted = self.trusted_simulation
        return self if trusted is None else replace(self, trusted_simulation=trusted._replace(share=share))

    def bounds(self) -> tuple[Floats, Floats]:
        """Lowest and highest parameter vector phi of any car: I_z, C_f, C_r within a factor of usual ones.

        A fit without what is missing runs away with them: a tyre of endless stiffness and hardly any grip, say,
        does what a drag does that grows with the steering.
        """
        car, low, high = self.nominal, np.full(self.base_size, -np.inf), np.full(self.base_size, np.inf)
        inertia = car.m * car.l_f * car.l_r, LIKELIHOOD_LIMITS.inertia_factor
        stiffness = car.m, LIKELIHOOD_LIMITS.stiffness_per_mass_factor
        following = car.m / USUAL_FOLLOWING_S, USUAL_FOLLOWING_S / FASTEST_FOLLOWING_S
        usual_values = {"I_z": inertia, "C_f": stiffness, "C_r": stiffness}
        for symbol, (usual, factor) in (usual_values | ({"K_t": following} if car.follows_wheel else {})).items():
            k = self.log_parameters.index(symbol)
            low[k] = min(np.log(usual / factor), np.log(getattr(car, symbol)))
            high[k] = max(np.log(usual * factor), np.log(getattr(car, symbol)))
        own, units = [p for _, p in self.effect_parameters], self.effect_units()
        free = np.full(len(self.remainder.sd), np.inf)
        return np.r_[low, [p.low for p in own] / units, -free], np.r_[high, [p.high for p in own] / units, free]

    def is_at_bound(self, phi: Floats) -> Bools:
        """Mask of the parameter vector phi: True where a component is at its `bounds`, as near as refits end."""
        low, high = self.bounds()
        return np.asarray(np.minimum(phi - low, high - phi) < LIKELIHOOD_LIMITS.near_bound)

    def effect_values(self, phi: Floats) -> dict[str, float]:
        """The effects' parameters (SI) in the parameter vector phi, by their field among the switches."""
        raw = phi[self.base_size : self.named_size] * self.effect_units()
        return dict(zip((f for f, _ in self.effect_parameters), raw.tolist(), strict=True))

    def car(self, phi: Floats) -> Car:
        """The car with the base parameters in the parameter vector phi."""
        logs = dict(zip(self.log_parameters, np.exp(phi[: len(self.log_parameters)]).tolist(), strict=True))
        drags = phi[len(self.log_parameters) : self.base_size] * self.drag_units
        return self.nominal._replace(**logs, **dict(zip(DRAG, drags.tolist(), strict=True)))

    def functions(self, phi: Floats) -> UnnamedFunctions:
        """The remainder's functions on the body and in the tracking, with their coefficients in phi."""
        return self.remainder.with_coefficients(phi[self.named_size :] * self.remainder.sd)

    def prediction_inputs(self, phi: Floats, take: Take) -> PredictionInputs:
        """The car, effect switches and commands after the actuators that predict `take` at the parameter vector phi."""
        car, own = self.car(phi), self.functions(phi)
        every = self.known.join(own)
        e = effect_switches(self.effect_values(phi), every.on_body, every.plan)
        chain = cached_actuator_chain(take, car, self.angle_limit, e)
        return PredictionInputs(car, e, chain, self.constants, own.on_body, own.tracking, self.known.tracking)
