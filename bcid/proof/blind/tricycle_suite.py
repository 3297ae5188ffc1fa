"""The tier of tricycles in a blind test: one of three effects of vehicle and tracking, sometimes two of them.

Sizes are those at which a lab's work goes wrong: a wheel that stands a few degrees off, a tracked point measured to
some centimetres, a tracking that filters for some hundredths of a second.
"""

import itertools
from collections.abc import Callable, Iterator
from functools import partial

import numpy as np

from bcid.proof.blind.concealed_effects import ConcealedEffect
from bcid.proof.blind.tricycle_case import TricycleCase
from bcid.simulation.car import Sensor
from bcid.simulation.tricycle import draw_tricycle
from bcid.simulation.tricycle_drive import COMMAND_RATES_HZ, Encoder, TricycleHandling

TIER = "tricycle"
EFFECTS = ("steering_offset", "marker_offset", "pose_latency")
SINGLES_PER_PAIR = 3
"""Cases of one effect for each of two: sometimes two things are wrong."""

SHORTEST_S, LONGEST_S = 120, 240
POSE_RATES_HZ = (20.0, 25.0, 30.0, 40.0, 50.0)
OFFSET_RAD, MARKER_M, LATENCY_S = (0.02, 0.06), (0.03, 0.08), (0.03, 0.09)
LATE_S = 0.015  # of an encoder's speed against its stamp, either way, at most

TricycleCaseDraw = Callable[[int, int], TricycleCase]
"""Draws a case from the suite's seed and the case's number."""


def draft_tricycle_cases(count: int) -> Iterator[TricycleCaseDraw]:
    """Yield for each of `count` cases of a tricycle, in order, the function that draws it.

    Effects follow each other, every fourth case has two of them.  Of each effect's cases every other one goes backward
    half of the time.
    """
    pairs, singles = itertools.cycle(itertools.combinations(EFFECTS, 2)), itertools.cycle((e,) for e in EFFECTS)
    for k in range(count):
        turn, place = divmod(k, SINGLES_PER_PAIR + 1)
        effects = next(pairs if place == SINGLES_PER_PAIR else singles)
        yield partial(_draw_case, effects, 0.5 * ((turn + place) % 2))


def _draw_case(effects: tuple[str, ...], reverse_share: float, seed: int, number: int) -> TricycleCase:
    """Draw a tricycle with `effects` that goes backward for `reverse_share` of its targets."""
    rng = np.random.default_rng([seed, number, 3])
    tricycle = draw_tricycle(rng)
    hidden = tuple(_draw_effect(name, rng) for name in effects)
    fast = float(rng.uniform(0.9, 1.5))
    tracker = Sensor(
        position_noise=float(rng.uniform(1e-3, 3e-3)), yaw_noise=float(rng.uniform(1e-3, 3e-3)),
        marker_offset_x=round(float(rng.uniform(0.3, 1.2)), 3), marker_offset_y=round(float(rng.uniform(-0.2, 0.2)), 3),
    )  # fmt: skip
    return TricycleCase(
        TIER, number, hidden, seed=seed, tricycle=tricycle, handling=TricycleHandling(0.3, fast, reverse_share),
        encoder=Encoder(float(rng.uniform(-LATE_S, LATE_S)), 2e-3), tracker=tracker,
        command_hz=float(rng.choice(COMMAND_RATES_HZ)), rate_hz=float(rng.choice(POSE_RATES_HZ)),
        duration_s=float(rng.integers(SHORTEST_S, LONGEST_S + 1)),
    )  # fmt: skip


def _draw_effect(name: str, rng: np.random.Generator) -> ConcealedEffect:
    """Draw the size and the sign or direction of one of EFFECTS."""
    if name == "steering_offset":
        offset = float(rng.uniform(*OFFSET_RAD) * rng.choice([-1.0, 1.0]))
        return ConcealedEffect(name, {"steering_offset": offset}, parameters={"o": offset})
    if name == "marker_offset":
        off, angle = rng.uniform(*MARKER_M), rng.uniform(-np.pi, np.pi)
        x, y = float(off * np.cos(angle)), float(off * np.sin(angle))
        return ConcealedEffect(
            name, sensor={"marker_offset_x": x, "marker_offset_y": y}, parameters={"d_x": x, "d_y": y}
        )
    late = float(rng.uniform(*LATENCY_S))
    return ConcealedEffect(name, sensor={"pose_latency": late}, parameters={"tau": late})
