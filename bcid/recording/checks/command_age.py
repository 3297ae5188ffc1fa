"""How old commands are when they are logged, where the recorder reads them at its own rate.

A loop that reads the latest command every P seconds and stamps it then logs each command late, by its age at that
moment.  Commands that come at nearly the same rate are a little older, or younger, with every reading, until one is
skipped or read twice: at the time t (s) of a take the age is

    a(t) = P ((phase + f t) mod 1),

a saw of the beat frequency f (Hz, of either sign) of the two loops.  No clock that is late or drifts does this, as the
saw falls back by P.  The car shows it: commands act later than they are stamped by D - a(t), D being what servo and
transport take.
"""

from dataclasses import replace
from typing import Literal, NamedTuple

import numpy as np

from bcid.aliases import Floats
from bcid.recording.checks.block_delays import DELAY, BlockDelays, block_delays
from bcid.recording.checks.limits import COMMAND_AGE as LIMITS
from bcid.recording.checks.steering_fit import SteeringFit, fit_steering
from bcid.recording.checks.turning import TurningData, liveliest
from bcid.recording.types import Irregularity, Recording, Stream, command_source_path
from bcid.vehicle import Vehicle


class CommandAge(NamedTuple):
    """The age of logged commands over the time of a take."""

    read_every_s: float  # P
    beat_hz: float  # f; above 0 commands are older at each reading
    phase: float  # share of P at the take's time zero
    nats: float  # by which the saw explains the delays of blocks better than an even drift does

    def at(self, time_s: Floats) -> Floats:
        """The ages (N,) in s of commands that are stamped at `time_s` (N,) (s)."""
        return np.asarray(self.read_every_s * np.mod(self.phase + self.beat_hz * time_s, 1.0))

    def in_force_from(self, time_s: Floats) -> Floats:
        """When commands came in force (N,) (s) that are stamped at the rising `time_s` (N,) (s), in the same order.

        Where the saw falls back, two readings may have come from one instant.
        """
        since: Floats = np.minimum.accumulate((time_s - self.at(time_s))[::-1])[::-1]
        return since


def reading_period(commands: Stream) -> float:
    """The time (s) between the readings that logged the `commands`: the longest of which all steps are multiples.

    Steps are those between changes, as a table may repeat each reading in many rows.  Infinite where there is none.
    """
    changed = 1 + np.flatnonzero((np.diff(commands.values, axis=0) != 0.0).any(axis=1))
    steps = np.diff(commands.time_s[changed])
    if len(steps) < LIMITS.least_changes:
        return float("inf")
    longest = min(LIMITS.most_s, LIMITS.short_step * float(np.quantile(steps, LIMITS.short_quantile)))
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
    stated_s = _stated_period(vehicle)
    age = find_command_age(data, vehicle, fit, fixed, stated_s or reading_period(recording.commands))
    if stated_s is None:
        return (recording if age is None else _say(recording, "warning", age)), data, fit
    recording = (
        take_off_mean_age(recording, vehicle) if age is None else _say(take_off_age(recording, age), "fixed", age)
    )
    data = with_commands_in_force(data, age or _mean_age(stated_s))
    part, theta = liveliest(data, LIMITS.fitted_s), fit.theta.copy()
    theta[DELAY] += 0.5 * stated_s
    return recording, data, fit_steering([part], vehicle, fixed, theta[DELAY], start=theta)


def take_off_mean_age(recording: Recording, vehicle: Vehicle) -> Recording:
    """The recording less half a period of reading, where the vehicle file states one: no age is shown."""
    stated_s = _stated_period(vehicle)
    if stated_s is None:
        return recording
    age = _mean_age(stated_s)
    return _say(take_off_age(recording, age), "fixed", age)


def _stated_period(vehicle: Vehicle) -> float | None:
    """How often (s) the recorder reads the commands by the vehicle file; None where it does not say."""
    return vehicle.clock.commands_read_every_s if vehicle.clock else None


def _mean_age(read_every_s: float) -> CommandAge:
    """Half a period of reading all the time: what is expected where the turning does not show it."""
    return CommandAge(read_every_s, 0.0, 0.5, 0.0)


def _say(recording: Recording, action: Literal["fixed", "warning"], age: CommandAge) -> Recording:
    """The recording with what is to be said of the `age` of its commands."""
    read_s = age.read_every_s
    text = f"read by the recorder every {1e3 * read_s:.0f} ms, and up to as old then"
    if not age.beat_hz:
        text += ": half of it is taken off, as the turning does not show more"
    elif action == "fixed":
        text += f", by a saw of {abs(1.0 / age.beat_hz):.0f} s: taken off, by how the car turns"
    else:
        text += (
            f", by a saw of {abs(1.0 / age.beat_hz):.0f} s; [clock] commands_read_every_s = {read_s:.2g} takes it off"
        )
    where = command_source_path(recording.sources)
    odd = Irregularity("command age", action, len(recording.commands), where, text)
    return replace(recording, irregularities=(*recording.irregularities, odd))


def take_off_age(recording: Recording, age: CommandAge) -> Recording:
    """The recording with its commands from the times on from which they were in force."""
    since = age.in_force_from(recording.commands.time_s)
    last = np.r_[np.diff(since) > 0.0, True]  # of those from one instant
    return replace(recording, commands=Stream(since[last], recording.commands.values[last]))


def with_commands_in_force(data: TurningData, age: CommandAge) -> TurningData:
    """The turning with its commands from the times on from which they were in force."""
    return data._replace(command_s=age.in_force_from(data.command_s))


def find_command_age(
    data: TurningData, vehicle: Vehicle, fit: SteeringFit, fixed: dict[str, float], read_every_s: float
) -> CommandAge | None:
    """The age of commands that are read every `read_every_s` (s), by how the car turns; None where no saw is shown.

    The delays of blocks are those of the `fit`, of a servo whose values in `fixed` are known, and then of a fit to the
    commands from when they were in force.  A saw must explain them better than an even drift, by `least_nats`.
    """
    if not LIMITS.least_s <= read_every_s <= LIMITS.most_s:
        return None
    age = CommandAge(read_every_s, 0.0, 0.0, 0.0)
    for _ in range(LIMITS.rounds):
        led = with_commands_in_force(data, age)
        blocks = block_delays(led, vehicle, fit, LIMITS.block_s, LIMITS.min_block_share)
        if len(blocks.delay_s) < LIMITS.min_blocks:
            return None
        stamped = blocks._replace(delay_s=blocks.delay_s - age.at(blocks.middle_s))
        age = _likeliest_saw(stamped, read_every_s)
        if age.nats < LIMITS.least_nats:
            return None
        part = liveliest(with_commands_in_force(data, age), LIMITS.fitted_s)
        fit = fit_steering([part], vehicle, fixed, start=fit.theta)
    return age


def _likeliest_saw(blocks: BlockDelays, P: float) -> CommandAge:
    """The saw of the height `P` (s) under which the delays of the `blocks` are likeliest."""
    t, seconds = blocks.middle_s, float(np.ptp(blocks.middle_s))
    step = LIMITS.beat_step / seconds
    rising = np.arange(step, LIMITS.fastest_hz, step)
    beats = np.r_[-rising[::-1], rising]
    phases = np.arange(LIMITS.phases) / LIMITS.phases
    f, phase = (x.ravel() for x in np.meshgrid(beats, phases, indexing="ij"))
    saws = -P * np.mod(phase[:, None] + f[:, None] * t, 1.0)
    drifts = np.linspace(-2.0 * P, 2.0 * P, LIMITS.drifts)[:, None] * (t - t.mean()) / seconds
    by_saw, by_drift = _scatter_about(saws, blocks), _scatter_about(drifts, blocks)
    k = int(np.argmin(by_saw))
    # of errors with Laplace's density, its width fitted
    nats = len(t) * float(np.log(by_drift.min() / by_saw[k]))
    return CommandAge(P, float(f[k]), float(phase[k]), nats)


def _scatter_about(shapes: Floats, blocks: BlockDelays) -> Floats:
    """Mean absolute deviations (M,) in s of the blocks' delays from each of `shapes` (M, B) and its best constant."""
    weights = blocks.information**0.5
    left = blocks.delay_s - shapes
    order = np.argsort(left, axis=1)
    half = np.cumsum(weights[order], axis=1) >= 0.5 * weights.sum()
    median = order[np.arange(len(left)), half.argmax(axis=1)]
    constant = left[np.arange(len(left)), median]
    return np.asarray(np.abs(left - constant[:, None]) @ weights / weights.sum())
