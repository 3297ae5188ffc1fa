"""What to drive so that a take shows what is asked."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from bcid.aliases import Floats
from bcid.effects.constants import Constants
from bcid.effects.entry import Effect
from bcid.experiment.detectability import Option, Sizes, detectable, fit_at, needed, options_of
from bcid.experiment.discrimination import driven, information
from bcid.experiment.manoeuvres import ARENA, SPEED_MPS, Arena, Drive, catalogue, top_speed, usual_throttle
from bcid.experiment.patterns import COMMAND_HZ
from bcid.likelihood.hypothesis import PRIOR_SD, Hypothesis
from bcid.likelihood.marginal import Scales
from bcid.likelihood.prepare import units_at
from bcid.likelihood.score_test import changes_of
from bcid.likelihood.take import SEGMENT_S, in_one, joined
from bcid.physics.car import Car
from bcid.vehicle import Vehicle

REST_S = 3.0  # between two drives, to bring the car back
MOST_DRIVES = 24
TIMES = (1, 2, 4, 8)  # that the whole plan is driven, for what shows over time
WORTH_DRIVING = 1e-3  # of what is asked, per second
MARGIN = 1.5  # over what is needed, when drives are chosen: the gain of a take varies
PROMISING = 2.0  # times the declared size: what shows from there on shows sooner in a longer plan

NOMINAL = Scales(np.array([3e-4, 3e-4, 6e-4]), np.array([0.02, 0.02, 0.02]))
"""Of a motion capture and a floor as they usually are, where no take is there yet to tell."""


@dataclass(frozen=True)
class Part:
    """One drive of a plan; the car is brought to `drive.start` before it."""

    drive: Drive
    begin_s: float


@dataclass(frozen=True)
class Plan:
    """What to drive, one part after the other with REST_S between, and what that would show."""

    parts: tuple[Part, ...]
    command_s: Floats  # (n,) at COMMAND_HZ
    command: Floats  # (n, 2) steering rad, throttle
    smallest: dict[str, Sizes | None]  # of each asked effect, the smallest size that shows
    missing: dict[str, str]  # asked effects that would not show at their declared size, and why

    @property
    def minutes(self) -> float:
        """How long it takes, without the time that bringing the car back may take longer."""
        return len(self.command) / COMMAND_HZ / 60.0


def plan(
    car: Car, constants: Constants, angle_limit: float, scales: Scales, effects: Sequence[str], arena: Arena = ARENA,
    top: float | None = None, unknown_steering: tuple[str, ...] = (),
) -> Plan:  # fmt: skip
    """The drives of the catalogue that make `effects` detectable at their declared sizes.

    Chosen one by one, each time the drive that adds most per second; driven twice and more often where time alone
    is lacking.  `top` is the largest throttle, `unknown_steering` those of T_s and d that a diagnosis will refit.
    """
    top = usual_throttle(car) if top is None else top
    hypothesis = Hypothesis((), car, angle_limit, constants, unknown_steering, units_at(car, top_speed(car, top)))
    phi = hypothesis.start(car)
    drives, strange = catalogue(car, angle_limit, top, arena), [e for e in effects if e not in hypothesis.entries]
    effects = [e for e in effects if e in hypothesis.entries]
    never = dict.fromkeys(strange, "this vehicle cannot have it")
    if not (drives and effects):
        missing = never | dict.fromkeys(effects, "no manoeuvre fits the arena")
        return Plan((), np.empty(0), np.empty((0, 2)), dict.fromkeys(missing), missing)
    chosen = _chosen(drives, hypothesis, phi, scales, effects)
    best: Plan | None = None
    for times in TIMES:
        if times > 1 and times * len(chosen) > MOST_DRIVES:
            break
        now = _planned(chosen * times, hypothesis, phi, scales, effects)
        if best is None or len(now.missing) < len(best.missing):
            best = now
        if not any(_promising(now.smallest[n], hypothesis.entries[n]) for n in now.missing):
            break
    assert best is not None  # noqa: S101  # TIMES begins with 1
    return replace(best, smallest=best.smallest | dict.fromkeys(strange), missing=best.missing | never)


def _excess(sizes: Sizes | None, effect: Effect) -> float:
    """The smallest size that shows over the declared one, of the amplitude that shows least."""
    if sizes is None or any(p.symbol not in sizes for p in effect.amplitudes):
        return math.inf
    return max(sizes[p.symbol][0] / p.size for p in effect.amplitudes)


def _promising(sizes: Sizes | None, effect: Effect) -> bool:
    """Whether driving longer may show the effect: what grows with time always may."""
    return "time" in effect.depends_on or _excess(sizes, effect) < PROMISING


def _planned(
    drives: Sequence[Drive], hypothesis: Hypothesis, phi: Floats, scales: Scales, effects: Sequence[str]
) -> Plan:
    """The drives one after the other, and what they would show together."""
    takes = [driven(drive, hypothesis, phi, scales, seed)[0] for seed, drive in enumerate(drives)]
    smallest = detectable(hypothesis, phi, scales, in_one(joined(takes)), effects)
    missing = {}
    for name, sizes in smallest.items():
        if _excess(sizes, hypothesis.entries[name]) > 1.0:
            told = ", ".join(f"{s} = {v:.3g} {unit}" for s, (v, unit) in (sizes or {}).items())
            missing[name] = f"shows from {told} on" if sizes else "no manoeuvre that fits excites it"
    begins, rows = [], list[Floats]()
    for drive in drives:
        if rows:
            rows.append(np.tile([drive.command[0, 0], 0.0], (round(REST_S * COMMAND_HZ), 1)))
        begins.append(sum(map(len, rows)) / COMMAND_HZ)
        rows.append(drive.command)
    command = np.vstack(rows)
    parts = tuple(Part(d, b) for d, b in zip(drives, begins, strict=True))
    return Plan(parts, np.arange(len(command)) / COMMAND_HZ, command, smallest, missing)


def _chosen(
    drives: Sequence[Drive], hypothesis: Hypothesis, phi: Floats, scales: Scales, effects: Sequence[str]
) -> list[Drive]:
    """The drives picked one by one, those picked twice spread over the plan.

    All are simulated once, one after the other, and what the picked ones show is added up over their segments.
    """
    takes = [driven(drive, hypothesis, phi)[0] for drive in drives]
    whole = in_one(joined(takes))
    options = options_of(effects, whole, hypothesis)
    fit = fit_at(hypothesis, phi, scales, whole)
    tried = changes_of(fit, whole, [(o.effect, [o.values]) for o in options]).columns
    columns = np.concatenate([fit.tangent.J, tried], axis=2)
    each = information(whole, hypothesis.setting(phi, whole), scales, columns)
    tables = [part.sum(axis=0) for part in np.split(each, np.cumsum([take.segments for take in takes])[:-1])]
    n = hypothesis.base_size
    known = np.zeros_like(tables[0])
    known[:n, :n] = np.eye(n) / PRIOR_SD**2
    picked = list[int]()

    def progress(numbers: Sequence[int]) -> float:
        total = known + sum(tables[k] for k in numbers)
        left = np.diag(total)[n:] - np.einsum(
            "bk,bk->k", total[:n, n:], np.linalg.lstsq(total[:n, :n], total[:n, n:], rcond=None)[0]
        )
        segments = sum(drives[k].seconds for k in numbers) / SEGMENT_S
        need = {name: MARGIN * needed(hypothesis.entries[name], int(segments)) for name in effects}
        return sum(_share(name, options, 0.5 * left, need[name]) for name in effects)

    now = 0.0
    while len(picked) < MOST_DRIVES // 2:
        gains = [(progress([*picked, k]) - now) / drive.seconds for k, drive in enumerate(drives)]
        best = int(np.argmax(gains))
        if picked and gains[best] < WORTH_DRIVING:
            break
        picked.append(best)
        now = progress(picked)
    spread = sorted(range(len(picked)), key=lambda i: (picked[:i].count(picked[i]), i))
    return [drives[picked[i]] for i in spread]


def _share(name: str, options: Sequence[Option], gains: Floats, need: float) -> float:
    """How much of what the effect must gain it gains, at most 1: its poorest amplitude, in the median of its places."""
    indices = {o.which for o in options if o.effect == name}
    return min(
        float(np.median([min(g / need, 1.0) for o, g in zip(options, gains.tolist(), strict=True)
                         if (o.effect, o.which) == (name, i)]))
        for i in indices
    )  # fmt: skip


def largest_throttle(vehicle: Vehicle) -> float:
    """The largest throttle of the vehicle: its reference speed (m/s), or 1 where the throttle sets a force."""
    return vehicle.motor.reference_speed_mps or (1.0 if vehicle.motor.law == "force" else SPEED_MPS)


def nominal_car(vehicle: Vehicle, T_s: float = 0.15, d: float = 2.0) -> Car:
    """A car as the vehicle file describes it, with what it does not say in proportion to mass and size.

    Rear wheels are stiffer and grip more than the front one, as in the bumper car; `T_s` (s) and `d` (rad/s) stand
    where the file omits them.
    """
    m, l_f, l_r = vehicle.mass_kg, vehicle.body.cog_to_front_m, vehicle.body.cog_to_rear_m
    steering = vehicle.steering
    car = Car(
        m=m, I_z=1.6 * m * l_f * l_r, l_f=l_f, l_r=l_r, T_s=steering.time_constant_s or T_s,
        d=steering.max_rate_radps or d, F_m_max=1.3 * m, K_t=0.9 * m, K_b=1.9 * m, C_f=12.0 * m, C_r=25.0 * m,
        F_f_max=2.0 * m, F_r_max=4.0 * m, R_1=0.14 * m, R_2=0.012 * m, v_0=1.0, front_share=vehicle.front_share,
    )  # fmt: skip
    if vehicle.motor.law == "speed":
        return car
    return car._replace(sets_force=1.0, K_t=1.3 * m / largest_throttle(vehicle), u_0=0.05, K_v=0.3 * m)
