"""The Newton-Euler car with effects of the vocabulary: what a diagnosis makes, as a model like the others.

Estimates, and so histories and outputs, are of the *seen* pose:

    p_seen = (1 + kappa) (p + R(theta) d),   theta_seen = theta + psi,   v_seen = (1 + kappa) R(-psi) (v + w x d).

A pose that comes late, or on a fast clock, is the same as commands that come that much later.  No step knows the
commands after its own, so poses that come early act as far as delays of the commands make up for it.
"""

import difflib
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Annotated, Any, ClassVar, Self

import numpy as np
from pydantic import Field, field_validator, model_validator

from bcid.aliases import Floats, Switches
from bcid.effects.constants import Constants
from bcid.effects.table import ENTRIES, OFF, effect_switches
from bcid.errors import UsageError
from bcid.estimate.limits import LIMITS as ESTIMATE_LIMITS
from bcid.models.interface import Arrays, CompiledModel, FitTask, History, ScanKernels, build_scan_kernels
from bcid.models.limits import LIMITS
from bcid.models.newton_euler import augmented_step
from bcid.models.newton_euler.model import equation_lines
from bcid.models.newton_euler.parameters import constant_units
from bcid.models.newton_euler.saved_car import EffectFacts, SavedCar
from bcid.models.saved_parts import Period, Positive, SavedPart, Signed, check_arrays, parse_saved
from bcid.physics.car import Car, integration_step


class SavedConstants(SavedPart):
    """The constants in the effects' equations, as a model is saved with them."""

    v_c: Positive
    w_c: Positive
    v_p: Positive
    track: Positive


class SavedAugmented(SavedPart):
    """The JSON part of a saved Newton-Euler car with effects."""

    car: SavedCar
    effects: dict[str, Signed]
    constants: SavedConstants
    angle_limit: Annotated[float, Field(gt=0.0, le=LIMITS.max_steering_rad)]
    recording_s: Annotated[float, Field(gt=0.0, le=LIMITS.max_recording_s)]
    period_s: Period
    facts: EffectFacts

    @field_validator("effects")
    @classmethod
    def _check_names(cls, effects: dict[str, float]) -> dict[str, float]:
        """Refuse parameters that no effect has, and a scale of the poses that turns them around."""
        for name in effects:
            if name not in OFF:
                near = ", ".join(difflib.get_close_matches(name, OFF, n=3))
                raise ValueError(f"there is no {name!r}" + (f", perhaps {near}" if near else ""))
        if effects.get("pose_scale__kappa", 0.0) <= -1.0:
            raise ValueError("pose_scale__kappa is -1 or less, which no camera has")
        return effects

    @model_validator(mode="after")
    def _check_delay(self) -> Self:
        """Refuse commands that act too late: a model keeps all that are on their way."""
        delay = max_command_delay(effect_switches(self.effects), self.recording_s)
        if delay > LIMITS.max_delay_s:
            raise ValueError(f"effects that delay commands by {delay:g} s, which no car has")
        if delay > LIMITS.max_delay_periods * self.period_s:
            raise ValueError(f"effects that delay commands by {delay:g} s, too long for periods of {self.period_s:g} s")
        return self


class DiagnosedCar(CompiledModel):
    """A compiled car that a diagnosis makes; of many, one is advanced after the other by the kernel for one.

    A compiled loop over cars would have to hold the whole car once more.
    """

    name: ClassVar[str]
    setup: Any  # what the kernel needs beside carry and commands

    @property
    def kernel_arguments(self) -> tuple[Any, ...]:
        """What the compiled scan needs beside carry and commands."""
        return (self.setup,)

    @classmethod
    def fit(cls, task: FitTask) -> Self:
        """Refuse to fit: effects are found by a diagnosis, not asked for.

        Raises:
            UsageError: always.
        """
        raise UsageError(f"{cls.name} is made by `bcid diagnose`\n  next: run it on the recording")

    def scan_many(self, carries: Floats, commands: Floats) -> tuple[Floats, Floats]:
        """Advance B vehicles (B, n) under `commands`, (B, N, 2) or parts (B, N, W, 4): last carries, twists."""
        after, parts = np.array(carries, dtype=np.float64, order="C"), self._parts(commands)
        twists = [self.kernels.scan(carry, own, self.setup) for carry, own in zip(after, parts, strict=True)]
        return after, np.stack(twists) if twists else np.empty((0, parts.shape[1], 3))


@dataclass(frozen=True)
class AugmentedNewtonEuler(DiagnosedCar):
    """The Newton-Euler car with effects.

    In `facts`, "fitted" names the constants of the car that were refitted, and "se" holds standard errors by constant
    and by the effects' fields.
    """

    car: Car
    effects: Mapping[str, float]  # the parameters of the effects that are on, by field of the switches
    constants: Constants
    angle_limit: float  # of the steering command, rad
    recording_s: float  # T in the effects' equations
    period_s: float
    facts: Mapping[str, Any]
    motion: ClassVar[slice] = slice(3, 6)
    kernels: ClassVar[ScanKernels] = build_scan_kernels(augmented_step.scan_augmented, parallel=False)
    name: ClassVar[str] = "newton-euler-augmented"
    lags: ClassVar[int] = 10

    @property
    def parameter_count(self) -> int:
        """How many numbers the diagnosis fitted: refitted constants and effects' parameters."""
        return len(self.facts.get("fitted", ())) + len(self.effects)

    @cached_property
    def setup(self) -> augmented_step.AugmentedSetup:
        """What the compiled step needs beside the carry."""
        e = effect_switches(self.effects)
        steps = max(1, math.ceil(self.period_s / integration_step(self.car) - 1e-9))
        late = math.ceil(max_command_delay(e, self.recording_s) / self.period_s)
        kept = late * ESTIMATE_LIMITS.max_command_parts + 1
        return augmented_step.AugmentedSetup(
            self.car, e, self.constants, self.angle_limit, self.recording_s, self.period_s, steps, kept
        )  # fmt: skip

    def with_period(self, period_s: float) -> Self:
        """This car advancing by `period_s` (s) a step."""
        return replace(self, period_s=period_s)

    def init(self, history: History) -> Floats:
        """The carry at the history's last row: its body, and the steering run through the history's commands."""
        s, time_s, delta = self.setup, history.time_s, history.kinematic[:, 3]
        # Rows before the first known one only repeat it.
        first = int(np.flatnonzero(time_s == time_s[0])[-1])
        b = augmented_step.body_from_tracked(history.pose[-1], history.twist[-1], s.switches)
        parts = history.parts[first:]
        durations, values = parts[..., 0].ravel(), parts[..., 1:].reshape(-1, 3)
        given = float(time_s[first]) + np.r_[0.0, np.cumsum(durations)[:-1]]
        commands = np.column_stack([given, values])[durations > 0.0] if len(parts) else None
        if commands is None:  # nothing is known of the past: coasting, the wheel held where it is
            commands = np.array([[time_s[-1] - self.period_s, delta[-1], 0.0, 0.0]])
        state = augmented_step.initial_state(b, float(delta[first]), commands, len(parts), float(time_s[-1]), s)
        carry: Floats = augmented_step.pack_carry(state)
        return carry

    def describe(self) -> str:
        """The car's equations and constants, refitted ones marked with *, then every effect with its parameters."""
        fitted, errors = self.facts.get("fitted", ()), self.facts.get("se", {})
        units = constant_units(self.car)
        lines = equation_lines(self.car)
        for symbol, unit in units.items():
            mark = "*" if symbol in fitted else " "
            lines.append(_value_line(f"{symbol:10}{mark}", getattr(self.car, symbol), errors.get(symbol), unit))
        for effect in ENTRIES.values():
            shown = [(f, p) for f, p in zip(effect.fields, effect.parameters, strict=True) if f in self.effects]
            if shown:
                lines.append(f"{effect.id}: {effect.equation}")
            for field, p in shown:
                line = _value_line(f"{p.symbol:10}*", self.effects[field], errors.get(field), p.unit)
                lines.append(f"{line}  {p.meaning}")
        fixed = f"T = {self.recording_s:g} s, track = {self.constants.track:g} m, |u_s| <= {self.angle_limit:g} rad"
        return "\n".join([*lines, f"t counts from the take's beginning; {fixed}"])

    def to_saved(self) -> tuple[dict[str, Any], Arrays]:
        """The JSON object from which `from_saved` restores the model; no arrays."""
        return {
            "car": self.car._asdict(), "effects": dict(self.effects), "constants": self.constants._asdict(),
            "angle_limit": self.angle_limit, "recording_s": self.recording_s, "period_s": self.period_s,
            "facts": dict(self.facts),
        }, {}  # fmt: skip

    @classmethod
    def from_saved(cls, data: Mapping[str, Any], arrays: Arrays) -> Self:
        """The model that `to_saved` gave `data` of.

        Raises:
            ValueError: an unknown effect, a value that is no finite number, or one that no car has.
        """
        check_arrays(arrays, {})
        saved = parse_saved(SavedAugmented, data)
        return cls(
            saved.car.to_car(), saved.effects, Constants(**saved.constants.model_dump()), saved.angle_limit,
            saved.recording_s, saved.period_s, saved.facts.as_mapping(),
        )  # fmt: skip


def max_command_delay(e: Switches, T: float) -> float:
    """The longest time (s) from a command to its effect on the recorded poses, by the effects' parameters `e`.

    It is the longer delay of steering and motor, that of a throttle that is logged too early among the motor's, plus
    the poses' latency and what the clock drifts in `T` seconds.
    """
    motor = e.motor_delay__tau + max(e.throttle_timing__tau, 0.0)
    actuators: float = max(e.steering_delay__tau, motor)
    poses: float = abs(e.pose_latency__tau) + abs(e.clock_drift__rho) * T
    return actuators + poses


def _value_line(name: str, value: float, error: float | None, unit: str) -> str:
    """One printed line of a constant: its name, value, standard error `error` (unless None) and unit."""
    return f"  {name} = {value:<10.4g} {f'± {error:<8.2g}' if error is not None else '':10} {unit}"
