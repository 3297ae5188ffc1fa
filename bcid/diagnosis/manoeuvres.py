"""What to drive next: a catalogue of manoeuvres that fit the floor, and which of them tells two rivals apart.

A manoeuvre is a pattern of commands; some also follow a route, whose steering is found under the car and then
written down, so that all of them are commands alone.  Each ends with the brake and fits the arena when the car
drives it from its start pose; patterns too wide are driven slower, or cut short, or left out.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple, Protocol

import numpy as np

from bcid.compiled import njit
from bcid.diagnosis.hypothesis import BUMPER_CAR, PRIOR_SD, Hypothesis, Setting
from bcid.diagnosis.marginal import Scales, eliminate, moments, products
from bcid.diagnosis.refit import Fit, jacobian, residuals, sensitivities
from bcid.diagnosis.search import GATE
from bcid.diagnosis.segments import half_steps, wrapped
from bcid.diagnosis.simulated import STILL, simulated_take, states, undriven
from bcid.diagnosis.take import STEP_S, Floats, Take
from bcid.effects.constants import Constants
from bcid.effects.entry import Units
from bcid.effects.motion import steering_chain
from bcid.effects.table import ENTRIES, off
from bcid.physics.car import Car, advance, motor_force
from bcid.physics.kinematics import pose_rate, wrap
from bcid.physics.motor import drag

COMMAND_HZ = 20
STOP_S = 2.0  # full brake at the end
LONGEST_S = 38.0  # without the stop
LEAST_S = 18.0
SPEEDS = (1.0, 0.85, 0.7, 0.55, 0.4, 0.3)  # shares of the top speed, tried in turn
LENGTHS = (1.0, 0.85, 0.7, 0.55)  # shares of the pattern
HEADINGS = 12  # over half a turn
REACHED_M = 0.5  # a way point this near is passed
POSE_HZ = 20.0  # of the simulated takes: one pose per group
MOST_REPEATS = 50
SPEED_MPS = 2.0  # of a vehicle of which nothing else is known


class Arena(NamedTuple):
    """A rectangle about the floor's origin, and how near its walls the CoG may come (m)."""

    length: float = 12.0
    width: float = 7.0
    margin: float = 0.8

    @property
    def reach(self) -> Floats:
        """Largest |x| and |y| (2,) of the CoG."""
        return 0.5 * np.array([self.length, self.width]) - self.margin


ARENA = Arena()


class Envelope(NamedTuple):
    """What a pattern may ask for: the car, its largest steering angle and throttle, a speed, a radius."""

    car: Car
    angle_limit: float  # rad
    top: float  # largest throttle
    speed: float  # m/s that a share of 1 means
    radius: float  # m, of a circle that fits the floor well

    def throttle(self, share: float) -> float:
        """The throttle that holds this share of the speed, straight on."""
        v, p = share * self.speed, self.car
        rolling = drag(v, p.R_1, p.R_2)
        wanted = p.u_0 + (rolling + p.K_v * v) / p.K_t if p.sets_force > 0.0 else v + rolling / p.K_t
        return float(min(max(wanted, 0.0), self.top))

    def circle(self, share: float = 1.0) -> float:
        """The steering angle of a circle of this share of the radius, without slip."""
        wheelbase = self.car.l_f + self.car.l_r
        return min(math.atan2(wheelbase, math.sqrt(max((share * self.radius) ** 2 - self.car.l_r**2, 1e-6))),
                   self.lock(0.9))  # fmt: skip

    def lock(self, share: float, most: float = math.inf) -> float:
        """A share of the largest steering angle, at most `most`."""
        return min(share * self.angle_limit, most)

    def turn_s(self, angle: float, share: float, turns: float) -> float:
        """How long so many turns take at this steering angle and share of the speed, without slip."""
        rate = share * self.speed * math.sin(angle) / (self.car.l_f + self.car.l_r)
        return 2.0 * math.pi * turns / max(rate, 1e-3)


class Order(NamedTuple):
    """Steering and throttle (n, 2) at COMMAND_HZ; where there is a route, the steering is added to what it asks."""

    command: Floats
    route: Floats = np.empty((0, 2))  # (W, 2) way points in shares of the arena's reach


def _held(*pieces: tuple[float, float, float]) -> Floats:
    """Commands (n, 2) that hold each (seconds, steering, throttle) in turn."""
    return np.concatenate([np.tile([s, u], (max(round(t * COMMAND_HZ), 1), 1)) for t, s, u in pieces])


def _waves(seconds: float, steer: Callable[[Floats], Floats], throttle: float) -> Floats:
    """Commands (n, 2) whose steering is a function of time."""
    t = np.arange(round(seconds * COMMAND_HZ)) / COMMAND_HZ
    return np.column_stack([steer(t), np.full(len(t), throttle)])


def coast_down(e: Envelope) -> Order:
    """Up to speed and let roll: on a wide circle either way, then with the wheel far over."""
    wide, far, up = e.circle(0.9), e.lock(0.7, 1.4), e.throttle(1.0)
    return Order(_held((4, wide, up), (8, wide, 0), (4, -wide, up), (8, -wide, 0), (5, -wide, up), (7, -far, 0)))


def steady_circles_slow(e: Envelope) -> Order:
    """A steady circle to the left, then one to the right, at half speed."""
    return Order(_held((13, e.circle(0.9), e.throttle(0.5)), (13, -e.circle(0.9), e.throttle(0.5))))


def steady_circles_fast(e: Envelope) -> Order:
    """A steady circle to the left, then one to the right, at full speed."""
    return Order(_held((13, e.circle(0.9), e.throttle(1.0)), (13, -e.circle(0.9), e.throttle(1.0))))


def small_steering_steps(e: Envelope) -> Order:
    """Steps of 0.1 rad about a circle either way."""
    middle, step, up = e.circle(), e.lock(0.25, 0.1), e.throttle(0.8)
    left = [(1.5, middle + hand * step, up) for hand in (1, -1) * 5]
    return Order(_held(*left, *((t, -s, u) for t, s, u in left)))


def large_steering_steps(e: Envelope) -> Order:
    """Steps from side to side so large that the servo runs at its rate limit."""
    angle, up = e.lock(0.6, 1.3), e.throttle(0.7)
    return Order(_held(*((t, hand * angle, up) for k in (1, -1) for t, hand in ((2.8, k), (1.8, -k)) * 3)))


def steering_sweep(e: Envelope) -> Order:
    """Sines of growing frequency (0.2 to 2.5 Hz) about a circle."""
    size, seconds, low, high = e.lock(0.4, 0.35), 30.0, 0.2, 2.5
    growth = math.log(high / low)
    return Order(
        _waves(
            seconds,
            lambda t: e.circle() + size * np.sin(2 * np.pi * low * seconds / growth * np.expm1(growth * t / seconds)),
            e.throttle(0.8),
        )
    )


def throttle_steps(e: Envelope) -> Order:
    """Steps of the throttle up and down, on a circle either way."""
    shares = (0.4, 1.0, 0.6, 1.0, 0.2, 0.8)
    return Order(_held(*((2.7, hand * e.circle(), e.throttle(s)) for hand in (1, -1) for s in shares)))


def throttle_noise(e: Envelope) -> Order:
    """A binary random sequence of the throttle, on a circle either way."""
    bits = np.random.default_rng(5).random(60) < 0.5
    return Order(
        _held(*((0.5, e.circle() * (1 if k < 30 else -1), e.throttle(1.0 if b else 0.3)) for k, b in enumerate(bits)))
    )


def brake_pulses(e: Envelope) -> Order:
    """Up to speed, a pulse of the brake, and again harder, on a circle either way."""
    pulses = ((0.7, 0.2), (0.6, 0.4), (0.5, 0.7), (0.5, 1.0))
    return Order(
        _held(*(p for hand in (1, -1) for t, brake in pulses for p in (
            (3.0, hand * e.circle(), e.throttle(1.0)), (t, hand * e.circle(), -brake))))
    )  # fmt: skip


def slalom(e: Envelope) -> Order:
    """A sine of the steering on the way round an oval."""
    corners = [(-0.5, -0.7), (0.5, -0.7), (0.95, 0.0), (0.5, 0.7), (-0.5, 0.7), (-0.95, 0.0)]
    return Order(
        _waves(30.0, lambda t: e.lock(0.5, 0.4) * np.sin(2 * np.pi * t / 2.2), e.throttle(0.8)), np.array(corners * 4)
    )


def figure_of_eight(e: Envelope) -> Order:
    """Full turns to the left and to the right in exchange."""
    angle, up = e.circle(0.65), e.throttle(0.9)
    turn = e.turn_s(angle, 0.85, 1.0)
    return Order(_held(*((turn, hand * angle, up) for hand in (1, -1) * max(round(16.0 / turn), 1))))


def full_lock(e: Envelope) -> Order:
    """Turns at full lock, slow and fast, either way."""
    angle = e.lock(0.98)
    return Order(_held(*((4.5, hand * angle, e.throttle(s)) for s in (0.5, 1.0, 0.7) for hand in (1, -1))))


def steering_reversals(e: Envelope) -> Order:
    """The steering thrown over at constant throttle, after half a turn, three quarters and a whole one."""
    angle, up = e.lock(0.5, 0.9), e.throttle(1.0)
    turns = (1.0, 0.75, 0.5, 0.75) * 3
    return Order(
        _held(*((e.turn_s(angle, 0.8, n), (-1) ** k * angle, up) for k, n in enumerate(turns)))[: 30 * COMMAND_HZ]
    )


def four_headings(e: Envelope) -> Order:
    """Round the floor along its four walls one way, across, and the other way."""
    a, b, c, d = (-0.75, -0.75), (0.75, -0.75), (0.75, 0.75), (-0.75, 0.75)
    across = [(0.0, 0.0), (-0.7, 0.1), (-0.4, 0.65)]
    return Order(_held((38, 0, e.throttle(0.9))), np.array([a, b, c, d, a, b, *across, c, b, a, d]))


def lawn_mower(e: Envelope) -> Order:
    """To and fro over the whole floor in lanes."""
    lanes = np.repeat(np.linspace(-0.85, 0.85, 6), 2)
    ends = np.resize([-0.75, 0.75, 0.75, -0.75], len(lanes))
    return Order(_held((38, 0, e.throttle(0.95))), np.column_stack([ends, lanes]))


def begin_and_end(e: Envelope) -> Order:
    """The same starts and circles at the begin and at the end, with a rest between."""
    bend, fast, slow = e.circle(0.65), e.throttle(1.0), e.throttle(0.5)
    laps = ((4, bend, fast), (3, bend, slow), (4, -bend, fast), (2, -bend, -0.6))
    return Order(_held(*laps, (9, bend, 0), *laps))


PATTERNS: tuple[Callable[[Envelope], Order], ...] = (
    coast_down, steady_circles_slow, steady_circles_fast, small_steering_steps, large_steering_steps, steering_sweep,
    throttle_steps, throttle_noise, brake_pulses, slalom, figure_of_eight, full_lock, steering_reversals,
    four_headings, lawn_mower, begin_and_end,
)  # fmt: skip
"""The catalogue."""


@dataclass(frozen=True)
class Drive:
    """Commands that keep the car inside the arena when it sets out from rest at `start`."""

    name: str
    purpose: str
    command_s: Floats  # (n,) at COMMAND_HZ
    command: Floats  # (n, 2) steering rad, throttle
    start: Floats  # (3,) x, y (m), yaw (rad)

    @property
    def seconds(self) -> float:
        """How long it takes."""
        return len(self.command) / COMMAND_HZ


@dataclass(frozen=True)
class Manoeuvre(Drive):
    """The drive that tells two rivals apart."""

    why: str
    score: float  # expected log-likelihood difference of one drive, nats
    repeats: int  # drives until it reaches GATE


class Commanded(Protocol):
    """Whatever holds commands to be driven."""

    @property
    def command_s(self) -> Floats:
        """Times (n,)."""

    @property
    def command(self) -> Floats:
        """Steering and throttle (n, 2)."""


def top_speed(car: Car, top: float) -> float:
    """The speed (m/s) that the throttle `top` reaches straight on."""
    from scipy.optimize import brentq

    def excess(v: float) -> float:
        return float(motor_force(top, v, car) - max(drag(v, car.R_1, car.R_2), 1e-2 * car.m * v))

    return float(brentq(excess, 0.0, 100.0, xtol=1e-3)) if excess(0.0) > 0.0 else 0.0


def usual_throttle(car: Car, units: Units = BUMPER_CAR) -> float:
    """The largest throttle of a car of which only the size and the speed of driving are known."""
    return 1.0 if car.sets_force > 0.0 else SPEED_MPS * units.m / units.s


def catalogue(car: Car, angle_limit: float, top: float, arena: Arena = ARENA) -> list[Drive]:
    """The manoeuvres that fit `arena` when this car drives them with throttles up to `top`.

    `top` is a speed (m/s), or a unit throttle where the throttle sets a force.
    """
    radius = 0.76 * float(arena.reach.min())
    if radius <= 0.0:
        return []
    gripping = math.sqrt(0.5 * (car.F_f_max + car.F_r_max) / car.m * radius)
    e = Envelope(car, angle_limit, top, min(top_speed(car, top), gripping), radius)
    drives = (_placed(pattern, e, arena) for pattern in PATTERNS) if e.speed > 0.0 else ()
    return [d for d in drives if d is not None]


def _placed(pattern: Callable[[Envelope], Order], e: Envelope, arena: Arena) -> Drive | None:
    """The pattern as fast and then as long as it fits; None where it does not."""
    name, purpose = pattern.__name__.replace("_", "-"), (pattern.__doc__ or "").strip().rstrip(".")
    for share in SPEEDS:
        order = pattern(e._replace(speed=share * e.speed))
        for length in LENGTHS:
            count = round(min(length * len(order.command), LONGEST_S * COMMAND_HZ))
            if count < LEAST_S * COMMAND_HZ:
                break
            command, start = order.command[:count], np.zeros(3)
            if len(order.route):
                route = order.route * arena.reach
                start = np.array([*route[0], math.atan2(*(route[1] - route[0])[::-1])])
                command = _steered(command, route, start, e.car, e.angle_limit)
            command = np.vstack([command, _held((STOP_S, float(command[-1, 0]), -1.0))])
            path = _path(command, start, e)
            found = _moved_inside(path, arena) if not len(order.route) else start if inside(path, arena) else None
            if found is not None:
                return Drive(name, purpose, np.arange(len(command)) / COMMAND_HZ, command, found)
    return None


@njit
def _steered(command: Floats, route: Floats, start: Floats, p: Car, limit: float) -> Floats:
    """The commands with the front wheel pointed at one way point after the other, until the last is reached."""
    out = command.copy()
    x, y, theta = start
    state = (0.0, 0.0, 0.0, command[0, 0])
    goal, h = 1, 1.0 / COMMAND_HZ
    for k in range(len(command)):
        while goal < len(route) and math.hypot(route[goal, 0] - x, route[goal, 1] - y) < REACHED_M:
            goal += 1
        if goal == len(route):
            return out[: max(k, 1)]
        bearing = wrap(math.atan2(route[goal, 1] - y, route[goal, 0] - x) - theta)
        out[k, 0] = min(max(bearing + command[k, 0], -limit), limit)
        state = advance(state, out[k, 0], out[k, 1], p, h)
        rate_x, rate_y = pose_rate(theta, state[0], state[1])
        x, y, theta = x + h * rate_x, y + h * rate_y, theta + h * state[2]
    return out


def _path(command: Floats, start: Floats, e: Envelope) -> Floats:
    """States (n + 1, 6) of the bare car that drives these commands from rest."""
    T = len(command) / COMMAND_HZ
    times = np.arange(len(command)) / COMMAND_HZ
    chain = steering_chain(times, command, 0.0, half_steps(T), STEP_S, e.car, e.angle_limit, off())
    return states(Setting(e.car, off(), chain, Constants()), T, STILL, 0, np.r_[start, 0.0, 0.0, 0.0])


def inside(path: Floats, arena: Arena) -> bool:
    """Whether the CoG keeps its margin to the walls on a path (n, 2 or more)."""
    return bool((np.abs(path[:, :2]) <= arena.reach).all())


def _moved_inside(path: Floats, arena: Arena) -> Floats | None:
    """The start pose of a path from the origin that has it in the middle of the arena, or None if it is too wide."""
    for yaw in np.linspace(0.0, np.pi, HEADINGS, endpoint=False):
        turned = path[:, :2] @ np.array([[np.cos(yaw), np.sin(yaw)], [-np.sin(yaw), np.cos(yaw)]])
        low, high = turned.min(axis=0), turned.max(axis=0)
        if (high - low <= 2.0 * arena.reach).all():
            return np.array([*(-0.5 * (low + high)), yaw])
    return None


def driven(
    drive: Drive, hypothesis: Hypothesis, phi: Floats, scales: Scales = STILL, seed: int = 0, rate_hz: float = POSE_HZ
) -> tuple[Take, Setting]:
    """The take that the car at `phi` gives of the drive, and its setting."""
    setting = hypothesis.setting(phi, undriven(drive.command_s, drive.command, drive.seconds))
    start = np.r_[drive.start, 0.0, 0.0, 0.0]
    return simulated_take(
        setting, drive.command_s, drive.command, drive.seconds, scales, rate_hz, seed, start
    ), setting  # fmt: skip


def information(take: Take, setting: Setting, scales: Scales, columns: Floats) -> Floats:
    """Every segment's information columns^T P columns (S, n, n) about changes of the prediction (N, 3, n).

    Initial states and pushes are eliminated.
    """
    A, still = sensitivities(take, setting, take.start), np.zeros_like(take.pose)
    V = eliminate(moments(still, A, take.first), scales.r, scales.precisions()).V
    return np.asarray(products(still, A, columns, take.first, scales.r, V)[1])


Explanation = Fit | tuple[Hypothesis, Floats]
"""A fit, or a hypothesis at some phi, of which then nothing but the prior is known."""


def _known(of: Explanation) -> tuple[Hypothesis, Floats, Floats]:
    """Hypothesis, phi, and what is known of those of phi that a refit would move: all, or the base parameters."""
    if isinstance(of, Fit):
        return of.hypothesis, of.phi, np.asarray(np.linalg.pinv(of.covariance), dtype=float)
    return *of, np.eye(of[0].base_size) / PRIOR_SD**2


class Separation(NamedTuple):
    """How far one drive tells two explanations apart: products of their difference and the refitted parameters."""

    square: float  # d^T P d
    slope: Floats  # (n,) J^T P d
    curvature: Floats  # (n, n) J^T P J
    known: Floats  # (n, n) information of the parameters before the drive

    def score(self, repeats: int = 1) -> float:
        """Expected difference of the log-likelihoods (nats) after so many drives, the parameters refitted."""
        total = repeats * self.curvature + self.known
        taken = np.linalg.lstsq(total, repeats * self.slope, rcond=None)[0]
        return 0.5 * repeats * float(self.square - self.slope @ taken)


def separation(drive: Drive, one: Explanation, other: Explanation, scales: Scales) -> Separation:
    """What `drive` shows of the difference when `one` is true, from the same simulated states."""
    hypothesis, phi, known = _known(one)
    rival, its_phi, _ = _known(other)
    take, setting = driven(drive, hypothesis, phi)
    r = residuals(take, setting, take.start)
    d = wrapped(residuals(take, rival.setting(its_phi, take), take.start) - r)
    J = jacobian(take, hypothesis, phi, take.start, r, range(len(known)))
    G = information(take, setting, scales, np.concatenate([J, d[:, :, None]], axis=2)).sum(axis=0)
    return Separation(float(G[-1, -1]), G[:-1, -1], G[:-1, :-1], known)


def best_manoeuvre(
    one: Explanation, other: Explanation, scales: Scales, arena: Arena = ARENA, top: float | None = None
) -> Manoeuvre | None:
    """The drive of the catalogue that tells two rival explanations apart best; None if none does.

    The score is the expected log-likelihood difference: half of sum d^T P d over the segments, d the difference of
    the two predictions from the same states, with initial states and pushes eliminated and what `one` refits
    projected out.  `top` is the largest throttle that may be commanded.
    """
    hypothesis, phi, _ = _known(one)
    if top is None:
        top = usual_throttle(hypothesis.car(phi), hypothesis.units)
    walls = arena._replace(margin=0.0)
    drives = [
        drive
        for drive in catalogue(hypothesis.car(phi), hypothesis.angle_limit, top, arena)
        if inside(driven(drive, hypothesis, phi)[0].pose, walls)  # with the effects that `one` holds
    ]
    if not drives:
        return None
    found = [separation(drive, one, other, scales) for drive in drives]
    drive, best = max(zip(drives, found, strict=True), key=lambda pair: pair[1].score())
    repeats = next((n for n in range(1, MOST_REPEATS + 1) if best.score(n) >= GATE), None)
    if repeats is None:
        return None
    why = _why(hypothesis, _known(other)[0], drive, phi)
    return Manoeuvre(drive.name, drive.purpose, drive.command_s, drive.command, drive.start, why, best.score(), repeats)


def _why(one: Hypothesis, other: Hypothesis, drive: Drive, phi: Floats) -> str:
    """One sentence: what the two depend on, and how far the drive takes it."""
    ranges = _ranges(drive, one, phi)
    names = [n for n in (*one.effects, *other.effects) if (n in one.effects) != (n in other.effects)]
    told = [f"{n} depends on {' and '.join(ENTRIES[n].depends_on)}" for n in names]
    words = list(dict.fromkeys(w for n in names for w in ENTRIES[n].depends_on)) or ["v_x", "steering"]
    spans = [ranges[w] for w in words]
    return f"{'; '.join(told) or 'they differ in the base parameters'}: this drive has {', '.join(spans)}."


def _ranges(drive: Drive, hypothesis: Hypothesis, phi: Floats) -> dict[str, str]:
    """How far each quantity that an effect may depend on goes in the drive, in words."""
    setting = hypothesis.setting(phi, undriven(drive.command_s, drive.command, drive.seconds))
    path = states(setting, drive.seconds, STILL, 0, np.r_[drive.start, 0.0, 0.0, 0.0])
    p, delta, u = setting.car, setting.chain.delta[::2], drive.command[:, 1]
    v_x, v_y, omega = path[:, 3:].T
    hub, rear = v_y + p.l_f * omega, v_y - p.l_r * omega
    along, across = np.cos(delta) * v_x + np.sin(delta) * hub, np.cos(delta) * hub - np.sin(delta) * v_x
    wide = np.ptp(path[:, :2], axis=0)

    def span(word: str, values: Floats, unit: str) -> str:
        low, high = np.quantile(values, [0.01, 0.99])
        return f"{word} from {low:.2f} to {high:.2f} {unit}".rstrip()

    return {
        "v_x": span("v_x", v_x, "m/s"),
        "v_y": span("v_y", v_y, "m/s"),
        "speed": span("speed", np.hypot(v_x, v_y), "m/s"),
        "yaw_rate": span("yaw rate", omega, "rad/s"),
        "steering": span("steering", delta, "rad"),
        "steering_rate": span("steering rate", np.gradient(delta, STEP_S), "rad/s"),
        "throttle": span("throttle", np.maximum(u, 0.0), ""),
        "braking": span("braking", np.maximum(-u, 0.0), ""),
        "alpha_f": span("front slip", np.arctan(across / np.maximum(np.abs(along), p.v_0)), "rad"),
        "alpha_r": span("rear slip", np.arctan(rear / np.maximum(np.abs(v_x), p.v_0)), "rad"),
        "place": f"{wide[0]:.1f} by {wide[1]:.1f} m of floor",
        "heading": span("heading", path[:, 2], "rad"),
        "time": f"{drive.seconds:.0f} s",
    }


def write_commands(path: Path, drive: Commanded) -> None:
    """The commands file of a drive or a plan: `time_s,steering_rad,throttle_mps`, a row every 0.05 s."""
    rows = np.column_stack([drive.command_s, drive.command])
    lines = [f"{t:.3f},{steering:.5f},{throttle:.5f}" for t, steering, throttle in rows]
    path.write_text("\n".join(["time_s,steering_rad,throttle_mps", *lines, ""]), encoding="utf-8")
