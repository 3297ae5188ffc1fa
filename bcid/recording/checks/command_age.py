"""How old commands are when they are logged, where the recorder reads them at its own rate.

A loop that reads the latest command every P seconds and stamps it then logs each command late, by its age at that
moment.  Commands that come at nearly the same rate are a little older, or younger, with every reading, until one is
skipped or read twice: at the time t (s) of a take the age is

    a(t) = P ((phase + f t) mod 1),

a saw of the beat frequency f (Hz, of either sign) of the two loops.  No clock that is late, drifts or jumps once does
this, as the saw rises and falls back by P.  The car shows it: commands act later than they are stamped by D - a(t), D
being what servo and transport take.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Literal, NamedTuple

import numpy as np

from bcid.aliases import Floats
from bcid.recording.checks.block_delays import DELAY, BlockDelays, block_delays
from bcid.recording.checks.limits import CLOCK
from bcid.recording.checks.limits import COMMAND_AGE as LIMITS
from bcid.recording.checks.steering_fit import SteeringFit, fit_steering, predicted_turn
from bcid.recording.checks.turning import TurningData, liveliest
from bcid.recording.types import BRAKE_CHANNEL, Irregularity, Recording, Stream, command_source_path
from bcid.vehicle import Vehicle

AGE = "command age"
"""The kind of the irregularity."""


class CommandAge(NamedTuple):
    """The age of logged commands over the time of a take."""

    read_every_s: float  # P
    beat_hz: float  # f; above 0 commands are older at each reading
    phase: float  # share of P at the take's time zero

    @property
    def drifts(self) -> bool:
        """Whether it is a saw that the turning shows, and not what is expected where it shows none."""
        return self.beat_hz != 0.0

    def at(self, time_s: Floats) -> Floats:
        """The ages (N,) in s of commands that are stamped at `time_s` (N,) (s)."""
        return np.asarray(self.read_every_s * np.mod(self.phase + self.beat_hz * time_s, 1.0))

    def in_force_from(self, time_s: Floats) -> Floats:
        """When commands came in force (N,) (s) that are stamped at the rising `time_s` (N,) (s), in the same order.

        Where the saw falls back, two readings may have come from one instant.
        """
        since: Floats = np.minimum.accumulate((time_s - self.at(time_s))[::-1])[::-1]
        return since


class FoundAge(NamedTuple):
    """An age of commands, and servo and car fitted to the turning without it."""

    age: CommandAge
    fit: SteeringFit


def reading_period(commands: Stream) -> float:
    """The time (s) between the readings that logged the `commands`: the longest of which all steps are multiples.

    Steps are those between changes, as a table may repeat each reading in many rows.  Infinite where there is none.
    """
    changed = 1 + np.flatnonzero((np.diff(commands.values, axis=0) != 0.0).any(axis=1))
    steps = np.diff(commands.time_s[changed])
    if len(steps) < LIMITS.least_changes:
        return float("inf")
    longest = min(LIMITS.most_s, LIMITS.short_step * float(np.quantile(steps, LIMITS.short_quantile)))
    if longest < LIMITS.least_s:
        return float("inf")
    steps = steps[:: 1 + len(steps) // LIMITS.most_steps]
    periods = np.geomspace(LIMITS.least_s, LIMITS.most_s, LIMITS.periods)
    # 1 where every step is a multiple
    evenness = np.cos(2.0 * np.pi * steps / periods[:, None]).mean(axis=1)
    even = np.flatnonzero((evenness > LIMITS.least_evenness) & (periods < longest))
    if not len(even):
        return float("inf")
    near = np.flatnonzero(np.abs(periods / periods[even[-1]] - 1.0) < LIMITS.same_period)
    return float(periods[near[np.argmax(evenness[near])]])


def account_for_age(
    recording: Recording, data: TurningData, vehicle: Vehicle, fit: SteeringFit, fixed: dict[str, float]
) -> tuple[Recording, TurningData, SteeringFit]:
    """A recording, its turning and the `fit` to that, less the age of its commands where the vehicle file states it.

    Where the file does not state how often they are read, an age that is shown is warned of.
    """
    stated_s = vehicle.clock.commands_read_every_s
    period_s = stated_s or reading_period(recording.commands)
    found = find_command_age(data, vehicle, fit, fixed, period_s, expected=stated_s is not None)
    if stated_s is None:
        return (recording if found is None else _say(recording, "warning", found.age)), data, fit
    if found is None:
        age, theta = _mean_age(stated_s), fit.theta.copy()
        theta[DELAY] += 0.5 * stated_s
        found = FoundAge(age, _fit_again(data, vehicle, age, theta, fixed))
    recording = _say(take_off_age(recording, found.age), "fixed", found.age)
    return recording, with_commands_in_force(data, found.age), found.fit


def take_off_mean_age(recording: Recording, vehicle: Vehicle) -> Recording:
    """The recording less half a period of reading, where the vehicle file states one: no age is shown."""
    stated_s = vehicle.clock.commands_read_every_s
    if stated_s is None:
        return recording
    age = _mean_age(stated_s)
    return _say(take_off_age(recording, age), "fixed", age)


def _mean_age(read_every_s: float) -> CommandAge:
    """Half a period of reading all the time: what is expected where the turning does not show it."""
    return CommandAge(read_every_s, 0.0, 0.5)


def _say(recording: Recording, action: Literal["fixed", "warning"], age: CommandAge) -> Recording:
    """The recording with what is to be said of the `age` of its commands."""
    read_s = age.read_every_s
    text = f"commands are up to {1e3 * read_s:.0f} ms old when the recorder reads them"
    if not age.drifts:
        text += ": half of that is taken off, as the turning does not show more"
    else:
        text += f", by a saw of {abs(1.0 / age.beat_hz):.0f} s"
        advice = f"; [clock] commands_read_every_s = {float(f'{read_s:.2g}'):g} takes it off"
        text += ": taken off, by how the car turns" if action == "fixed" else advice
    where = command_source_path(recording.sources)
    odd = Irregularity(AGE, action, len(recording.commands), where, text)
    return replace(recording, irregularities=(*recording.irregularities, odd))


def take_off_age(recording: Recording, age: CommandAge) -> Recording:
    """The recording with its commands, the brake among them, from the times on from which they were in force."""
    channels = {n: _in_force(s, age) if n == BRAKE_CHANNEL else s for n, s in recording.channels.items()}
    return replace(recording, commands=_in_force(recording.commands, age), channels=channels)


def _in_force(stream: Stream, age: CommandAge) -> Stream:
    """Commands from the times on from which they were in force."""
    since = age.in_force_from(stream.time_s)
    last = np.r_[np.diff(since) > 0.0, True]  # of those from one instant
    return Stream(since[last], stream.values[last])


def with_commands_in_force(data: TurningData, age: CommandAge) -> TurningData:
    """The turning with its commands from the times on from which they were in force."""
    return data._replace(command_s=age.in_force_from(data.command_s))


def find_command_age(
    data: TurningData, vehicle: Vehicle, fit: SteeringFit, fixed: dict[str, float], read_every_s: float,
    expected: bool,
) -> FoundAge | None:  # fmt: skip
    """The age of commands that are read every `read_every_s` (s), by how the car turns; None where no saw is shown.

    The delays of blocks are those of the `fit`, of a servo whose values in `fixed` are known, and then of a fit to the
    commands from when they were in force.  A saw must explain them clearly better than a drift or a jump of one clock;
    where none is `expected`, by more than the best of so many does by chance.  Then it is moved to where least of the
    turning is left.
    """
    told = fit.explained > CLOCK.min_explained_share
    if not told or not LIMITS.least_s <= read_every_s <= LIMITS.most_s:
        return None
    age = CommandAge(read_every_s, 0.0, 0.0)
    block_s = max(LIMITS.block_s, float(np.ptp(data.time_s)) / LIMITS.most_blocks)
    for _ in range(LIMITS.rounds):
        led = with_commands_in_force(data, age)
        blocks = block_delays(led, vehicle, fit, block_s, LIMITS.min_block_share)
        if len(blocks.delay_s) < LIMITS.min_blocks:
            return None
        stamped = blocks._replace(delay_s=blocks.delay_s - age.at(blocks.middle_s))
        age, nats, tried = _likeliest_saw(stamped, read_every_s, block_s)
        if nats < LIMITS.least_nats + (0.0 if expected else np.log(tried)):
            return None
        fit = _fit_again(data, vehicle, age, fit.theta, fixed)
    for _ in range(LIMITS.rounds):
        age, theta = _move_saw(age, data, vehicle, fit.theta)
        fit = _fit_again(data, vehicle, age, theta, fixed)
    return FoundAge(age, fit)


def _fit_again(
    data: TurningData, vehicle: Vehicle, age: CommandAge, theta: Floats, fixed: dict[str, float]
) -> SteeringFit:  # fmt: skip
    """Servo and car fitted to the liveliest part of a take, from `theta` on, the commands being of that `age`."""
    part = liveliest(with_commands_in_force(data, age), CLOCK.fitted_s)
    return fit_steering([part], vehicle, fixed, float(theta[DELAY]), start=theta)


def _move_saw(age: CommandAge, data: TurningData, vehicle: Vehicle, theta: Floats) -> tuple[CommandAge, Floats]:
    """The `age` and `theta` with beat, phase and delay where the mean absolute residual of the turning is least nearby.

    A pattern search, whose steps are halved; the phase is that in the middle of the take, which hardly knows the beat.
    """
    t = data.time_s[data.rows]
    widths = np.array([LIMITS.beat_step / np.ptp(t), 1.0 / LIMITS.phases, LIMITS.delay_step_s])
    middle = float(t.mean())

    def saw_at(place: Floats) -> tuple[CommandAge, Floats]:
        """The age and theta with the beat, the phase in the middle and the delay of a `place` (3,)."""
        moved = theta.copy()
        moved[DELAY] = place[2]
        phase = float(np.mod(place[1] - place[0] * middle, 1.0))
        return age._replace(beat_hz=float(place[0]), phase=phase), moved

    def mean_residual(place: Floats) -> float:
        """Mean absolute residual of the turning (rad/s) with the saw at a `place` (3,)."""
        there, moved = saw_at(place)
        residual = data.turn - predicted_turn(moved, with_commands_in_force(data, there), vehicle)
        return float(np.abs(residual[data.rows]).mean())

    place = np.array([age.beat_hz, age.phase + age.beat_hz * middle, theta[DELAY]])
    least, share = mean_residual(place), 1.0
    while share > LIMITS.finest_share:
        near = [place + share * sign * step for step in np.diag(widths) for sign in (1.0, -1.0)]
        each = [mean_residual(p) for p in near]
        k = int(np.argmin(each))
        if each[k] < least:
            least, place = each[k], near[k]
        else:
            share *= 0.5
    return saw_at(place)


def _likeliest_saw(blocks: BlockDelays, P: float, block_s: float) -> tuple[CommandAge, float, int]:
    """The saw of the height `P` (s) under which the blocks' delays are likeliest, what speaks for it, and of how many.

    What speaks for it are the nats by which it explains the delays better than any even drift, and any jump of a clock.
    """
    t, seconds = blocks.middle_s, float(np.ptp(blocks.middle_s))
    step = LIMITS.beat_step / seconds
    rising = np.arange(step, LIMITS.fastest_beat / block_s, step)
    phases, best, least = np.arange(LIMITS.phases) / LIMITS.phases, CommandAge(P, 0.0, 0.0), np.inf
    for f in (*rising, *-rising):
        scatter = _scatter_about(-P * np.mod(phases[:, None] + f * t, 1.0), blocks)
        if scatter.min() < least:
            best, least = CommandAge(P, float(f), float(phases[scatter.argmin()])), float(scatter.min())
    sizes = np.linspace(-2.0 * P, 2.0 * P, LIMITS.drifts)[:, None]
    others = [_scatter_about(sizes * (t - t.mean()) / seconds, blocks).min()]
    others += [_scatter_about(sizes * (t > at), blocks).min() for at in t[:-1]]
    # of errors with Laplace's density, its width fitted
    return best, len(t) * float(np.log(min(others) / least)), 2 * len(rising) * LIMITS.phases


def _scatter_about(shapes: Floats, blocks: BlockDelays) -> Floats:
    """Mean absolute deviations (M,) in s of the blocks' delays from each of `shapes` (M, B) and its best constant."""
    weights = blocks.information**0.5
    left = blocks.delay_s - shapes
    order = np.argsort(left, axis=1)
    half = np.cumsum(weights[order], axis=1) >= 0.5 * weights.sum()
    median = order[np.arange(len(left)), half.argmax(axis=1)]
    constant = left[np.arange(len(left)), median]
    return np.asarray(np.abs(left - constant[:, None]) @ weights / weights.sum())
