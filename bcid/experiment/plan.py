"""What to drive so that a take shows given effects: a choice of drives, and the sizes that they make detectable."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from bcid.aliases import Floats
from bcid.effects.constants import Constants
from bcid.effects.entry import Effect
from bcid.experiment import detectability
from bcid.experiment.detectability import PlacedAmplitude, Sizes, required_gain_nats
from bcid.experiment.discrimination import segment_information, simulate_planned_drive
from bcid.experiment.limits import EXPERIMENT_LIMITS
from bcid.experiment.manoeuvres import ARENA, Arena, PlannedDrive, feasible_drives, top_speed
from bcid.experiment.patterns import COMMAND_HZ
from bcid.likelihood.hypothesis import USUAL_FOLLOWING_S, Hypothesis
from bcid.likelihood.limits import LIKELIHOOD_LIMITS
from bcid.likelihood.prepare import scale_at_speed
from bcid.likelihood.scales import Scales
from bcid.likelihood.score_test import compute_trial_changes
from bcid.likelihood.take import SEGMENT_S, as_one_recording, concatenate_takes
from bcid.physics.car import Car, typical_inertia_and_tyres
from bcid.vehicle import Vehicle

DEFAULT_SPEED_MPS = 2.0  # of a vehicle whose file gives no reference speed
REST_S = 3.0  # between two drives, to bring the car back
REPETITIONS = (1, 2, 4, 8)  # of the whole plan, for effects that show over time

NOMINAL_SCALES = Scales(np.array([3e-4, 3e-4, 6e-4]), np.full(3, 0.02), np.full(3, 0.4))
"""Noise of a motion capture and pushes of a floor as they usually are, where there is no take yet."""


@dataclass(frozen=True)
class ScheduledDrive:
    """One drive of a plan; the car is brought to `drive.start` before it."""

    drive: PlannedDrive
    begin_s: float


@dataclass(frozen=True)
class DrivingPlan:
    """Drives one after the other, with REST_S between them, and what they would show."""

    parts: tuple[ScheduledDrive, ...]
    command_s: Floats  # (n,) at COMMAND_HZ
    command: Floats  # (n, 2) steering rad, throttle
    detectable_sizes: dict[str, Sizes | None]  # of each asked effect, the smallest size that shows
    missing: dict[str, str]  # asked effects that would not show at their declared size, and why

    @property
    def minutes(self) -> float:
        """Duration (min) of the plan; bringing the car back may take longer."""
        return len(self.command) / COMMAND_HZ / 60.0


def plan_drives(
    car: Car, constants: Constants, angle_limit: float, effects: Sequence[str], max_throttle: float,
    arena: Arena = ARENA, unknown_steering: tuple[str, ...] = (),
) -> DrivingPlan:  # fmt: skip
    """Plan a sequence of drives in which the given `effects` would be detected at their declared sizes.

    Drives of the catalogue are chosen greedily by how much they raise the effects' expected log-likelihood gains
    towards the required ones, per second; the whole is repeated while that may detect more.  `max_throttle` is a
    speed (m/s), or 1 where the throttle sets a force, `angle_limit` the steering limit (rad); `unknown_steering`
    names those of the servo's "T_s" and "d" that a diagnosis will estimate too.
    """
    units = scale_at_speed(car, top_speed(car, max_throttle))
    hypothesis = Hypothesis((), car, angle_limit, constants, unknown_steering, units)
    drives = feasible_drives(car, angle_limit, max_throttle, arena)
    impossible = dict.fromkeys((e for e in effects if e not in hypothesis.entries), "this vehicle cannot have it")
    effects = [e for e in effects if e in hypothesis.entries]
    if not (drives and effects):
        missing = impossible | dict.fromkeys(effects, "no manoeuvre fits the arena")
        return DrivingPlan((), np.empty(0), np.empty((0, 2)), dict.fromkeys(missing), missing)
    chosen = _choose_drives(drives, hypothesis, effects)
    best: DrivingPlan | None = None
    for times in REPETITIONS:
        if times > 1 and times * len(chosen) > EXPERIMENT_LIMITS.max_drives:
            break
        plan = _assemble_plan(chosen * times, hypothesis, effects)
        if best is None or len(plan.missing) < len(best.missing):
            best = plan
        # repeated, a plan may show what grows with time, and what it nearly shows once
        entries = {n: hypothesis.entries[n] for n in plan.missing}
        smallest_ratio = min((_size_ratio(plan.detectable_sizes[n], e) for n, e in entries.items()), default=math.inf)
        nearly = smallest_ratio < EXPERIMENT_LIMITS.max_promising_ratio
        if not (nearly or any("time" in e.depends_on for e in entries.values())):
            break
    assert best is not None  # noqa: S101  # REPETITIONS begins with 1
    sizes = best.detectable_sizes | dict.fromkeys(impossible)
    return replace(best, detectable_sizes=sizes, missing=best.missing | impossible)


def _size_ratio(sizes: Sizes | None, effect: Effect) -> float:
    """Smallest detectable size of an effect over its declared size, the largest ratio among its strength parameters.

    It is inf where a parameter is not detectable at any size (`sizes` lacks it or is None).
    """
    if sizes is None or any(p.symbol not in sizes for p in effect.amplitude_parameters):
        return math.inf
    return max(sizes[p.symbol][0] / p.size for p in effect.amplitude_parameters)


def _assemble_plan(drives: Sequence[PlannedDrive], hypothesis: Hypothesis, effects: Sequence[str]) -> DrivingPlan:
    """Join drives, with pauses of REST_S, to one plan, and compute the smallest effect sizes that it would detect.

    The drives are simulated by the base model at its nominal parameters.  Effects that would not be detected at their
    declared size are listed as missing, with the reason in words.
    """
    phi = hypothesis.phi_of(hypothesis.nominal)
    takes = [simulate_planned_drive(d, hypothesis, phi, NOMINAL_SCALES, seed)[0] for seed, d in enumerate(drives)]
    whole = as_one_recording(concatenate_takes(takes))
    shown = detectability.detectable_sizes(hypothesis, phi, NOMINAL_SCALES, whole, effects)
    missing = {}
    for name, sizes in shown.items():
        if _size_ratio(sizes, hypothesis.entries[name]) > 1.0:
            quoted = ", ".join(f"{s} = {v:.3g} {unit}" for s, (v, unit) in (sizes or {}).items())
            missing[name] = f"shows from {quoted} on" if sizes else "no manoeuvre that fits excites it"
    begins, rows = [], list[Floats]()
    for drive in drives:
        if rows:
            rows.append(np.tile([drive.command[0, 0], 0.0], (round(REST_S * COMMAND_HZ), 1)))
        begins.append(sum(map(len, rows)) / COMMAND_HZ)
        rows.append(drive.command)
    command = np.vstack(rows)
    parts = tuple(ScheduledDrive(d, b) for d, b in zip(drives, begins, strict=True))
    return DrivingPlan(parts, np.arange(len(command)) / COMMAND_HZ, command, shown, missing)


def _choose_drives(
    drives: Sequence[PlannedDrive], hypothesis: Hypothesis, effects: Sequence[str]
) -> list[PlannedDrive]:
    """Choose drives greedily by progress per second, until no drive adds `min_progress_per_s`.

    Progress is the sum over `effects` of expected over required log-likelihood gain, each at most 1.  All drives are
    simulated once; a choice's Fisher information is the sum over its drives.  A drive may be chosen several times,
    and its repeats are spread over the plan.
    """
    phi = hypothesis.phi_of(hypothesis.nominal)
    takes = [simulate_planned_drive(drive, hypothesis, phi)[0] for drive in drives]
    whole = as_one_recording(concatenate_takes(takes))
    amplitudes = detectability.amplitudes_at_typical_places(effects, whole, hypothesis)
    fit = detectability.tangent_fit(hypothesis, phi, NOMINAL_SCALES, whole)
    trials = compute_trial_changes(fit, whole, [(a.effect, [a.values]) for a in amplitudes]).columns
    columns = np.concatenate([fit.tangent.J, trials], axis=2)
    by_segment = segment_information(whole, hypothesis.prediction_inputs(phi, whole), NOMINAL_SCALES, columns)
    by_drive = [part.sum(axis=0) for part in np.split(by_segment, np.cumsum([take.segments for take in takes])[:-1])]
    n = hypothesis.base_size
    known = np.zeros_like(by_drive[0])
    known[:n, :n] = np.eye(n) / LIKELIHOOD_LIMITS.base_prior_sd**2
    picked = list[int]()

    def progress(numbers: Sequence[int]) -> float:
        """Sum over the effects of the share of its required gain that each has in the drives `numbers`."""
        total = known + sum(by_drive[k] for k in numbers)
        base, cross = total[:n, :n], total[:n, n:]
        left = np.diag(total)[n:] - np.einsum("bk,bk->k", cross, np.linalg.lstsq(base, cross, rcond=None)[0])
        segments, margin = int(sum(drives[k].seconds for k in numbers) / SEGMENT_S), EXPERIMENT_LIMITS.gain_margin
        required = {name: margin * required_gain_nats(hypothesis.entries[name], segments) for name in effects}
        return sum(_progress_share(name, amplitudes, 0.5 * left, required[name]) for name in effects)

    now = 0.0
    while len(picked) < EXPERIMENT_LIMITS.max_drives // 2:
        rates = [(progress([*picked, k]) - now) / drive.seconds for k, drive in enumerate(drives)]
        best = int(np.argmax(rates))
        if picked and rates[best] < EXPERIMENT_LIMITS.min_progress_per_s:
            break
        picked.append(best)
        now = progress(picked)
    spread = sorted(range(len(picked)), key=lambda i: (picked[:i].count(picked[i]), i))
    return [drives[picked[i]] for i in spread]


def _progress_share(
    effect: str, amplitudes: Sequence[PlacedAmplitude], gains_nats: Floats, required_nats: float
) -> float:
    """Expected over required log-likelihood gain of one effect, at most 1.

    For each strength parameter it is the median over typical places; the least over the parameters is returned.
    `gains_nats` (K,) are the expected gains of the K `amplitudes`, of which those of other effects are ignored.
    """
    shares = dict[int, list[float]]()
    for a, gain in zip(amplitudes, gains_nats.tolist(), strict=True):
        if a.effect == effect:
            shares.setdefault(a.parameter_index, []).append(min(gain / required_nats, 1.0))
    return min(float(np.median(each)) for each in shares.values())


def largest_throttle(vehicle: Vehicle) -> float:
    """Largest throttle command of a vehicle: its reference speed (m/s), or 1 where the throttle sets a force.

    A vehicle file without a reference speed is taken to reach DEFAULT_SPEED_MPS, if its throttle sets a speed.
    """
    return vehicle.motor.reference_speed_mps or (1.0 if vehicle.motor.law == "force" else DEFAULT_SPEED_MPS)


def nominal_car(vehicle: Vehicle) -> Car:
    """Typical base parameters for a vehicle file, for planning before anything has been driven.

    Mass, CoG and driven axle are as in the file; motor and drag are proportional to the mass, tyres and inertia
    typical of mass and size.  Rear wheels are stiffer and grip more than the front one, as in the bumper car; the
    servo has T_s = 0.15 s and d = 2 rad/s where the file omits them.
    """
    m, l_f, l_r = vehicle.mass_kg, vehicle.body.cog_to_front_m, vehicle.body.cog_to_rear_m
    steering = vehicle.steering
    car = Car(
        m=m, l_f=l_f, l_r=l_r, T_s=steering.time_constant_s or 0.15, d=steering.max_rate_radps or 2.0, F_m_max=1.3 * m,
        K_t=0.9 * m, K_b=1.9 * m, R_1=0.14 * m, R_2=0.012 * m, v_0=1.0, front_share=vehicle.front_share,
        **typical_inertia_and_tyres(m, l_f, l_r, inertia=1.6, grip_f=2.0, grip_r=4.0),
    )  # fmt: skip
    if vehicle.motor.law == "speed":
        return car
    if vehicle.motor.law == "measured-speed":
        return car._replace(F_m_max=1e3 * m, K_t=m / USUAL_FOLLOWING_S, K_b=0.0, reverses=1.0, follows_wheel=1.0)
    return car._replace(sets_force=1.0, K_t=1.3 * m / largest_throttle(vehicle), u_0=0.05, K_v=0.3 * m)
