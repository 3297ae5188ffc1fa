"""The Newton-Euler car with effects of the vocabulary: what a diagnosis makes, as a model like the others.

The carry is the car's own pose and twist, the lagging quantities, the steering on its way to the wheel, the time and
the commands that delays still hold back.  Estimates, and so histories and outputs, are of the *seen* pose:

    p_seen = (1 + kappa) (p + R(theta) d),   theta_seen = theta + psi,   v_seen = (1 + kappa) R(-psi) (v + w x d).

A pose that comes late, or on a fast clock, is the same as commands that come that much later.  No step knows the
commands after its own, so poses that come early act as far as delays of the commands make up for it.
"""

from __future__ import annotations

import difflib
import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar, NamedTuple, Self

import numba
import numpy as np
import numpy.typing as npt

from bcid.aliases import Floats
from bcid.compiled.njit import njit, njit_parallel
from bcid.effects.car import Body, Lagged
from bcid.effects.constants import Constants
from bcid.effects.motion import Servo, body_step, chain_on, settled
from bcid.effects.table import ENTRIES, OFF, switches
from bcid.errors import UsageError
from bcid.models.interface import Arrays, FitTask, History, Kernels, Scanned
from bcid.models.newton_euler.model import equation_lines
from bcid.physics.car import Car, integration_step

LONGEST_DELAY_S = 10.0
N_MOTION = 13  # of the carry: body, lags, steering and time; the commands follow
UNITS = {
    "m": "kg", "I_z": "kg m²", "l_f": "m", "l_r": "m", "T_s": "s", "d": "rad/s", "F_m_max": "N", "K_t": "N s/m",
    "K_b": "N s/m", "C_f": "N/rad", "C_r": "N/rad", "F_f_max": "N", "F_r_max": "N", "R_1": "N s/m", "R_2": "N s²/m²",
    "v_0": "m/s",
}  # fmt: skip
FORCE_UNITS = {k: v for k, v in UNITS.items() if k != "F_m_max"} | {"K_t": "N", "u_0": "-", "K_v": "N s/m"}


class Setup(NamedTuple):
    """All that a step needs beside the carry."""

    car: Car
    switches: Any
    constants: Constants
    limit: float  # of the steering command, rad
    T: float
    period: float
    steps: int  # integration steps in a period
    kept: int  # earlier commands in the carry


class Now(NamedTuple):
    """The carry in words."""

    body: Body
    lagged: Lagged
    servo: Servo
    t: float  # s since the take began
    commands: Floats  # (kept, 2) of the periods before


@njit
def packed(now: Now) -> Floats:
    """The carry (13 + 2 kept,) of `now`."""
    b, l, s = now.body, now.lagged, now.servo  # noqa: E741  # beside b and s
    x = np.empty(N_MOTION + now.commands.size)
    x[0], x[1], x[2], x[3], x[4], x[5] = b.p_x, b.p_y, b.theta, b.v_x, b.v_y, b.omega
    x[6], x[7], x[8], x[9], x[10], x[11], x[12] = l.alpha_f, l.F_mf, l.F_mr, s.angle, s.lagged, s.behind, now.t
    x[N_MOTION:] = now.commands.ravel()
    return x


@njit
def unpacked(x: Floats) -> Now:
    """The inverse of `packed`."""
    return Now(
        Body(x[0], x[1], x[2], x[3], x[4], x[5]), Lagged(x[6], x[7], x[8]), Servo(x[9], x[10], x[11]), x[12],
        x[N_MOTION:].copy().reshape(-1, 2),
    )  # fmt: skip


@njit
def seen_twist(b: Body, e: Any) -> tuple[float, float, float]:
    """Twist of the tracked body, in its own axes."""
    v_x, v_y = b.v_x - b.omega * e.marker_offset__d_y, b.v_y + b.omega * e.marker_offset__d_x
    grown, psi = 1.0 + e.pose_scale__kappa, e.body_yaw_misalignment__psi
    sin_p, cos_p = math.sin(psi), math.cos(psi)
    return grown * (cos_p * v_x + sin_p * v_y), grown * (cos_p * v_y - sin_p * v_x), b.omega


@njit
def unseen(pose: Floats, twist: Floats, e: Any) -> Body:
    """The CoG's pose and twist from those of the tracked body: `seen_pose` and `seen_twist` undone."""
    grown, psi = 1.0 + e.pose_scale__kappa, e.body_yaw_misalignment__psi
    d_x, d_y = e.marker_offset__d_x, e.marker_offset__d_y
    theta, omega = pose[2] - psi, twist[2]
    sin_t, cos_t, sin_p, cos_p = math.sin(theta), math.cos(theta), math.sin(psi), math.cos(psi)
    return Body(
        pose[0] / grown - cos_t * d_x + sin_t * d_y, pose[1] / grown - sin_t * d_x - cos_t * d_y, theta,
        (cos_p * twist[0] - sin_p * twist[1]) / grown + omega * d_y,
        (sin_p * twist[0] + cos_p * twist[1]) / grown - omega * d_x, omega,
    )  # fmt: skip


@njit
def _arrivals(t: float, count: int, s: Setup) -> Floats:
    """When the commands of the `count` periods up to the one that begins at `t` come, on the poses' clock."""
    e = s.switches
    given = t - s.period * np.arange(count - 1, -1, -1)
    arrivals: Floats = (given + e.pose_latency__tau) * (1.0 + e.clock_drift__rho)
    return arrivals


@njit
def start(b: Body, delta: float, commands: Floats, periods: int, t: float, s: Setup) -> Now:
    """The car at `t`, whose steering stood at `delta` so many `periods` before; `commands` (n, 2) are those before t.

    What lags is as if nothing had changed for long.
    """
    n, h = periods * s.steps, s.period / s.steps
    arrivals = _arrivals(t - s.period, len(commands), s)
    chain, servo = chain_on(
        Servo(delta, delta, delta), arrivals, commands, t - periods * s.period, n, h, s.car, s.limit, s.switches
    )
    lagged = settled(b, n, chain, s.T, s.car, s.switches, s.constants)
    kept = np.empty((s.kept, 2))
    for i in range(s.kept):
        kept[i] = commands[max(len(commands) - s.kept + i, 0)]
    return Now(b, lagged, servo, t, kept)


@njit
def advance(now: Now, u_s: float, u_m: float, s: Setup) -> Now:
    """One period under the command [u_s, u_m]."""
    commands = np.empty((s.kept + 1, 2))
    commands[:-1] = now.commands
    commands[-1, 0], commands[-1, 1] = u_s, u_m
    arrivals = _arrivals(now.t, s.kept + 1, s)
    h, e = s.period / s.steps, s.switches
    chain, servo = chain_on(now.servo, arrivals, commands, now.t, s.steps, h, s.car, s.limit, e)
    still = np.zeros(3)
    b, lagged = now.body, now.lagged
    for k in range(s.steps):
        b, lagged = body_step(b, lagged, k, chain, s.T, still, s.car, e, s.constants)
    return Now(b, lagged, servo, now.t + s.period, commands[1:].copy())


@njit
def _scan(carry: Floats, commands: Floats, s: Setup) -> Floats:
    twists = np.empty((len(commands), 3))
    now = unpacked(carry)
    for k in range(len(commands)):
        now = advance(now, commands[k, 0], commands[k, 1], s)
        twists[k, 0], twists[k, 1], twists[k, 2] = seen_twist(now.body, s.switches)
    carry[:] = packed(now)
    return twists


@njit_parallel
def _scan_many(carries: Floats, commands: Floats, s: Setup) -> Floats:
    twists = np.empty((len(carries), commands.shape[1], 3))
    for b in numba.prange(len(carries)):
        twists[b] = _scan(carries[b], commands[b], s)
    return twists


@dataclass(frozen=True)
class AugmentedNewtonEuler(Scanned):
    """The Newton-Euler car with effects.

    `facts` say how it was made: "fitted" names the constants of the car that were refitted, "se" holds standard
    errors by constant and by the effects' fields.
    """

    car: Car
    effects: Mapping[str, float]  # by field of the switches: those that are on
    constants: Constants
    angle_limit: float  # of the steering command, rad
    recording_s: float  # T in the effects' equations
    period_s: float
    facts: Mapping[str, Any]
    motion: ClassVar[slice] = slice(3, 6)
    kernels: ClassVar[Kernels] = Kernels(_scan, _scan_many)
    name: ClassVar[str] = "newton-euler-augmented"
    lags: ClassVar[int] = 10

    @property
    def parameter_count(self) -> int:
        """The refitted constants and the effects' parameters."""
        return len(self.facts.get("fitted", ())) + len(self.effects)

    @property
    def setup(self) -> Setup:
        """What the compiled step takes."""
        e = switches(self.effects)
        steps = max(1, math.ceil(self.period_s / integration_step(self.car) - 1e-9))
        kept = math.ceil(longest_delay(e, self.recording_s) / self.period_s) + 1
        return Setup(
            self.car, e, self.constants, self.angle_limit, self.recording_s, self.period_s, steps, kept
        )  # fmt: skip

    @classmethod
    def fit(cls, task: FitTask) -> Self:
        """Refused: effects are found, not asked for."""
        raise UsageError(f"{cls.name} is made by `bcid diagnose`\n  next: run it on the recording")

    def in_steps_of(self, period_s: float) -> Self:
        """See `Continuous`."""
        return replace(self, period_s=period_s)

    def init(self, history: History) -> Floats:
        """The steering from the history's oldest row on through its commands; the body from its last row."""
        s, time_s, delta = self.setup, history.time_s, history.kinematic[:, 3]
        first = int(np.flatnonzero(time_s == time_s[0])[-1])  # rows before only repeat it
        commands = history.command if len(history.command) else np.array([[delta[-1], 0.0]])
        b = unseen(history.pose[-1], history.twist[-1], s.switches)
        periods = len(time_s) - 1 - first
        now = start(b, float(delta[first]), np.ascontiguousarray(commands), periods, float(time_s[-1]), s)
        carry: Floats = packed(now)
        return carry

    @property
    def arguments(self) -> tuple[Any, ...]:
        """See `Scanned`."""
        return (self.setup,)

    def describe(self) -> str:
        """The car's equations and constants, refitted ones marked with *; then every effect with its own."""
        fitted, errors = self.facts.get("fitted", ()), self.facts.get("se", {})
        units = FORCE_UNITS if self.car.sets_force else UNITS
        lines = equation_lines(self.car)
        for symbol, unit in units.items():
            mark = "*" if symbol in fitted else " "
            lines.append(_told(f"{symbol:10}{mark}", getattr(self.car, symbol), errors.get(symbol), unit))
        for effect in ENTRIES.values():
            shown = [(f, p) for f, p in zip(effect.fields, effect.parameters, strict=True) if f in self.effects]
            if shown:
                lines.append(f"{effect.id}: {effect.equation}")
            for field, p in shown:
                told = _told(f"{p.symbol:10}*", self.effects[field], errors.get(field), p.unit)
                lines.append(f"{told}  {p.meaning}")
        held = f"T = {self.recording_s:g} s, track = {self.constants.track:g} m, |u_s| <= {self.angle_limit:g} rad"
        return "\n".join([*lines, f"t counts from the take's beginning; {held}"])

    def state(self) -> tuple[dict[str, Any], Arrays]:
        """See `Model.state`."""
        return {
            "car": self.car._asdict(), "effects": dict(self.effects), "constants": self.constants._asdict(),
            "angle_limit": self.angle_limit, "recording_s": self.recording_s, "period_s": self.period_s,
            "facts": dict(self.facts),
        }, {}  # fmt: skip

    @classmethod
    def from_state(cls, data: Mapping[str, Any], arrays: Mapping[str, npt.NDArray[Any]]) -> Self:
        """See `Model.from_state`.

        Raises:
            ValueError: an effect that is not known, or a value that is no number or means nothing.
        """
        single = ("angle_limit", "recording_s", "period_s")
        alone = _numbers("the model", {n: data[n] for n in single}, single)
        effects = _numbers("effects", data["effects"], OFF)
        e = switches(effects)
        delay = longest_delay(e, alone["recording_s"])
        if min(alone.values()) <= 0.0 or e.pose_scale__kappa <= -1.0 or delay > LONGEST_DELAY_S:
            raise ValueError(f"an angle, time or scale in it that no car has (delays of {delay:g} s)")
        facts = data["facts"]
        if not isinstance(facts, Mapping):
            raise ValueError("facts: no object")
        car = Car(**_numbers("car", data["car"], Car._fields))
        constants = Constants(**_numbers("constants", data["constants"], Constants._fields))
        return cls(car, effects, constants, **alone, facts=facts)


def longest_delay(e: Any, T: float) -> float:
    """How far back (s) the commands that act now may lie."""
    actuators: float = max(e.steering_delay__tau, e.motor_delay__tau)
    poses: float = abs(e.pose_latency__tau) + abs(e.clock_drift__rho) * T
    return actuators + poses


def _told(name: str, value: float, error: float | None, unit: str) -> str:
    """One line of a table of constants."""
    return f"  {name} = {value:<10.4g} {f'± {error:<8.2g}' if error is not None else '':10} {unit}"


def _numbers(what: str, given: Any, known: Collection[str]) -> dict[str, float]:
    """Finite numbers by known names; refused where `given` is anything else."""
    if not isinstance(given, Mapping):
        raise ValueError(f"{what}: no object of numbers")
    for name, value in given.items():
        if name not in known:
            near = ", ".join(difflib.get_close_matches(str(name), known, n=3))
            raise ValueError(f"{what}: there is no {name!r}" + (f", perhaps {near}" if near else ""))
        if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
            raise ValueError(f"{what}: {name} is {value!r}, no finite number")
    return {name: float(value) for name, value in given.items()}
