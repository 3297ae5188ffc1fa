"""The Newton-Euler car with effects of the vocabulary: what a diagnosis makes, as a model like the others.

Estimates, and so histories and outputs, are of the *seen* pose:

    p_seen = (1 + kappa) (p + R(theta) d),   theta_seen = theta + psi,   v_seen = (1 + kappa) R(-psi) (v + w x d).

A pose that comes late, or on a fast clock, is the same as commands that come that much later.  No step knows the
commands after its own, so poses that come early act as far as delays of the commands make up for it.
"""

import difflib
import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Self

import numpy as np

from bcid.aliases import Floats, Switches
from bcid.effects.constants import Constants
from bcid.effects.table import ENTRIES, OFF, effect_switches
from bcid.errors import UsageError
from bcid.models.interface import Arrays, CompiledModel, FitTask, History, ScanKernels, build_scan_kernels
from bcid.models.limits import LIMITS
from bcid.models.newton_euler import augmented_step
from bcid.models.newton_euler.model import equation_lines
from bcid.models.newton_euler.parameters import constant_units
from bcid.physics.car import Car, integration_step


@dataclass(frozen=True)
class AugmentedNewtonEuler(CompiledModel):
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

    @property
    def setup(self) -> augmented_step.AugmentedSetup:
        """What the compiled step needs beside the carry."""
        e = effect_switches(self.effects)
        steps = max(1, math.ceil(self.period_s / integration_step(self.car) - 1e-9))
        kept = math.ceil(max_command_delay(e, self.recording_s) / self.period_s) + 1
        return augmented_step.AugmentedSetup(
            self.car, e, self.constants, self.angle_limit, self.recording_s, self.period_s, steps, kept
        )  # fmt: skip

    @classmethod
    def fit(cls, task: FitTask) -> Self:
        """Refuse to fit: effects are found by a diagnosis, not asked for.

        Raises:
            UsageError: always.
        """
        raise UsageError(f"{cls.name} is made by `bcid diagnose`\n  next: run it on the recording")

    def with_period(self, period_s: float) -> Self:
        """This car advancing by `period_s` (s) a step."""
        return replace(self, period_s=period_s)

    def init(self, history: History) -> Floats:
        """The carry at the history's last row: its body, and the steering run through the history's commands."""
        s, time_s, delta = self.setup, history.time_s, history.kinematic[:, 3]
        # Rows before the first known one only repeat it.
        first = int(np.flatnonzero(time_s == time_s[0])[-1])
        commands = history.command if len(history.command) else np.array([[delta[-1], 0.0]])
        b = augmented_step.body_from_tracked(history.pose[-1], history.twist[-1], s.switches)
        periods = len(time_s) - 1 - first
        state = augmented_step.initial_state(
            b, float(delta[first]), np.ascontiguousarray(commands), periods, float(time_s[-1]), s
        )
        carry: Floats = augmented_step.pack_carry(state)
        return carry

    @property
    def kernel_arguments(self) -> tuple[Any, ...]:
        """What the compiled scan needs beside carry and commands."""
        return (self.setup,)

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
        scalar_names = ("angle_limit", "recording_s", "period_s")
        scalars = _check_finite_numbers("the model", {n: data[n] for n in scalar_names}, scalar_names)
        effects = _check_finite_numbers("effects", data["effects"], OFF)
        e = effect_switches(effects)
        delay = max_command_delay(e, scalars["recording_s"])
        if min(scalars.values()) <= 0.0 or e.pose_scale__kappa <= -1.0 or delay > LIMITS.max_delay_s:
            raise ValueError(f"an angle, time or scale in it that no car has (delays of {delay:g} s)")
        facts = data["facts"]
        if not isinstance(facts, Mapping):
            raise ValueError("facts: no object")
        car = Car(**_check_finite_numbers("car", data["car"], Car._fields))
        constants = Constants(**_check_finite_numbers("constants", data["constants"], Constants._fields))
        return cls(car, effects, constants, **scalars, facts=facts)


def max_command_delay(e: Switches, T: float) -> float:
    """The longest time (s) from a command to its effect on the recorded poses, by the effects' parameters `e`.

    It is the longer delay of steering and motor, plus the poses' latency and what the clock drifts in `T` seconds.
    """
    actuators: float = max(e.steering_delay__tau, e.motor_delay__tau)
    poses: float = abs(e.pose_latency__tau) + abs(e.clock_drift__rho) * T
    return actuators + poses


def _value_line(name: str, value: float, error: float | None, unit: str) -> str:
    """One printed line of a constant: its name, value, standard error `error` (unless None) and unit."""
    return f"  {name} = {value:<10.4g} {f'± {error:<8.2g}' if error is not None else '':10} {unit}"


def _check_finite_numbers(table_name: str, table: Any, known_names: Collection[str]) -> dict[str, float]:
    """Check that a saved `table` holds finite numbers of known names only, and return them by name.

    Raises:
        ValueError: it holds anything else; the message begins with `table_name`.
    """
    if not isinstance(table, Mapping):
        raise ValueError(f"{table_name}: no object of numbers")
    for name, value in table.items():
        if name not in known_names:
            near = ", ".join(difflib.get_close_matches(str(name), known_names, n=3))
            raise ValueError(f"{table_name}: there is no {name!r}" + (f", perhaps {near}" if near else ""))
        if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
            raise ValueError(f"{table_name}: {name} is {value!r}, no finite number")
    return {name: float(value) for name, value in table.items()}
