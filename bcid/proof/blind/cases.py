"""The suites of a blind test: cases of all tiers, drawn from one seed."""

import itertools
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from bcid.proof.blind.blind_case import USUAL_CASE, BlindCase
from bcid.proof.blind.concealed_effects import (
    LARGEST_SIZES,
    MEASUREMENT_EFFECTS,
    MORE_OUTSIDE_EFFECTS,
    OUTSIDE_EFFECTS,
    SIZE_RANGES,
    ConcealedEffect,
    draw_concealed_effect,
    draw_outside_effect,
)
from bcid.proof.blind.other_suite import draft_other_cases
from bcid.proof.blind.small_suite import draft_small_cases
from bcid.proof.blind.tricycle_suite import draft_tricycle_cases

FAMILIES = {
    "fx": (
        "rear_rolling_coulomb", "rear_rolling_viscous", "front_coulomb_friction", "quadratic_drag",
        "rear_drag_asymmetry", "steering_drag", "steering_friction", "rough_patch", "floor_slope", "tether_pull",
    ),
    "mz": ("yaw_scrub", "yaw_coulomb", "drive_lateral_offset", "rear_drag_asymmetry"),
    "fy": (
        "tyre_relaxation", "friction_circle", "tyre_soft_saturation", "load_transfer", "front_ply_steer", "rear_toe",
        "slippery_patch",
    ),
    "motor": (
        "motor_delay", "motor_lag", "motor_dead_zone", "motor_sag", "motor_power_limit", "motor_regeneration",
    ),
    "steering": (
        "steering_offset", "steering_backlash", "steering_dead_band", "steering_delay", "steering_lag",
        "steering_nonlinearity", "steering_side_gain", "steering_speed_gain", "steering_rate_asymmetry",
        "steering_compliance",
    ),
    "time": ("pose_latency", "clock_drift"),
    "pose": ("marker_offset", "body_yaw_misalignment", "pose_scale"),
}  # fmt: skip
"""Effects by channel; the whole family may not be named in a "left-out" case that conceals one of them."""

EXACT_EQUIVALENTS = {"pose_latency": ("steering_delay", "motor_delay")}
"""Effects that together equal another one exactly, and may not be named either in its "left-out" case."""

HARDER_RECORDINGS = (
    ("two-minutes", 120.0, 60.0, 1.0, 4), ("ten-hertz", 600.0, 10.0, 1.0, 4),
    ("three-times-noise", 600.0, 60.0, 3.0, 4),
)  # fmt: skip
UNUSUAL_RECORDINGS = (("thirty-minutes", 1800.0, 60.0, 1.0, 8), ("hundred-twenty-hertz", 600.0, 120.0, 1.0, 4))
"""Tiers of other recordings: name, duration (s), poses per second, times the usual noise; one effect in so many."""

NULLS_PER_SMALL_NULL = 5
"""Takes of the big car that conceal nothing for each such take of a small car."""

UNEXCITED_BY_CIRCLES = (
    "motor_power_limit", "friction_circle", "tyre_soft_saturation", "load_transfer", "steering_rate_asymmetry",
    "motor_regeneration",
)  # fmt: skip
"""Effects that slow circles do not show."""


EffectDraw = Callable[[np.random.Generator], tuple[ConcealedEffect, ...]]
"""Draws the concealed effects of a case with a random generator."""


class _CaseDraft(NamedTuple):
    """A case that has neither a number nor drawn effects yet."""

    tier: str
    draw_effects: EffectDraw
    fields: Mapping[str, Any] = MappingProxyType({})


def draw_suite(
    seed: int,
    repeats: int,
    nulls: int,
    imperfect_nulls: int,
    pairs: int,
    other_laws: int = 0,
    other_day: int = 0,
    tricycles: int = 0,
) -> Iterator[BlindCase]:
    """Draw all cases of a blind test (simulated drives with concealed effects) from one seed, tier by tier.

    A tier is a kind of case.  There are `repeats` cases of each effect alone, `nulls` without any effect,
    `imperfect_nulls` without any, but in a car that the base model cannot fit exactly, and `pairs` of two effects;
    further tiers have sizes of their own, among them those of small cars.  `other_laws` and `other_day` are the numbers
    of small cars that are other than published, with nothing withheld and once more less one effect; `tricycles` cases
    of such follow.  Each case has its own random generator.
    """
    big = list(_draft_cases(repeats, nulls, imperfect_nulls, pairs))
    for number, draft in enumerate(big):
        hidden = draft.draw_effects(np.random.default_rng([seed, number, 3]))
        yield BlindCase(draft.tier, number, hidden, seed=seed, **draft.fields)
    # each kind after all others, so that no case before has another number than it had
    small = draft_small_cases(repeats, math.ceil(nulls / NULLS_PER_SMALL_NULL))
    other = itertools.chain(small, draft_other_cases(other_laws, other_day), draft_tricycle_cases(tricycles))
    yield from (draw_case(seed, number) for number, draw_case in enumerate(other, len(big)))


def _draft_cases(repeats: int, nulls: int, imperfect_nulls: int, pairs: int) -> Iterator[_CaseDraft]:
    """Yield, for every blind case in order, its tier, a function that draws its effects, and its further fields.

    The arguments are numbers of cases, as in `draw_suite`; other tiers (kinds of case) have fixed sizes or follow
    from `pairs`.
    """
    for imperfect, tier in ((False, "single"), (True, "single-imperfect")):
        for effect in repeats * [*SIZE_RANGES]:
            yield _CaseDraft(tier, _one_effect_draw(effect), {"imperfect": imperfect})
    yield from nulls * [_CaseDraft("null", _several_effects_draw(0))]
    yield from imperfect_nulls * [_CaseDraft("null-imperfect", _several_effects_draw(0), {"imperfect": True})]
    for channel, family in FAMILIES.items():
        for effect in family:
            left_out = (*family, *EXACT_EQUIVALENTS.get(effect, ()))
            yield _CaseDraft("left-out", _one_effect_draw(effect), {"left_out": left_out, "channel": channel})
    yield from pairs * [_CaseDraft("pair", _several_effects_draw(2))]
    yield from _draft_recordings(HARDER_RECORDINGS, first=0)
    for effect in SIZE_RANGES:
        yield _CaseDraft("half-size", _one_effect_draw(effect, factor=0.5))
    for effect in SIZE_RANGES:
        if effect not in LARGEST_SIZES:
            yield _CaseDraft("double-size", _one_effect_draw(effect, factor=2.0))
    yield from (2 * pairs // 5) * [_CaseDraft("triple", _several_effects_draw(3))]
    yield from (2 * pairs // 5) * [_CaseDraft("measurement-and-vehicle", _draw_measurement_and_vehicle)]
    for effect, (channel, _) in repeats * [*OUTSIDE_EFFECTS.items()]:
        yield _CaseDraft("outside", _outside_effect_draw(effect), {"channel": channel})
    for effect in UNEXCITED_BY_CIRCLES:
        yield _CaseDraft("unexcited", _one_effect_draw(effect), {"driver": "circles"})
    for effect in [*SIZE_RANGES][1::2]:
        yield _CaseDraft("closed-loop", _one_effect_draw(effect), {"driver": "pursuit"})
    yield from _draft_recordings(UNUSUAL_RECORDINGS, first=2)
    # last, so that no case before has another number than it had
    for effect, (channel, _) in repeats * [*MORE_OUTSIDE_EFFECTS.items()]:
        yield _CaseDraft("outside", _outside_effect_draw(effect), {"channel": channel})


def _draft_recordings(recordings: Sequence[tuple[str, float, float, float, int]], first: int) -> Iterator[_CaseDraft]:
    """Yield drafts of blind cases with one effect in unusual recordings: longer, shorter, slower, faster or noisier.

    An entry of `recordings` is (tier, duration in s, poses per second, multiple of the usual noise, stride); its cases
    conceal every stride-th effect of SIZE_RANGES, one each, from index `first` on.
    """
    for tier, duration, rate, noise, stride in recordings:
        for effect in [*SIZE_RANGES][first::stride]:
            fields = {"duration_s": duration, "rate_hz": rate, "noise": noise}
            yield _CaseDraft(tier, _one_effect_draw(effect, duration), fields)


def _one_effect_draw(effect: str, duration: float = USUAL_CASE.duration_s, factor: float = 1.0) -> EffectDraw:
    """Return a function that draws one effect with random size, sign, and place or time, from a random generator.

    The size is from the effect's range in SIZE_RANGES, times `factor`; a time lies within a drive of `duration` (s).
    """
    return lambda rng: (draw_concealed_effect(effect, rng, duration, factor),)


def _outside_effect_draw(effect: str) -> EffectDraw:
    """Return a function that draws the size of an effect that the diagnosis cannot name, from a random generator.

    Such an effect, of OUTSIDE_EFFECTS or MORE_OUTSIDE_EFFECTS, exists only in the simulation and not among those that a
    diagnosis knows.
    """
    return lambda rng: (draw_outside_effect(effect, rng),)


def _several_effects_draw(count: int) -> EffectDraw:
    """Return a function that draws `count` different effects of SIZE_RANGES, with random sizes from their ranges."""
    names = list(SIZE_RANGES)
    return lambda rng: tuple(
        draw_concealed_effect(names[i], rng, USUAL_CASE.duration_s)
        for i in rng.choice(len(names), count, replace=False)
    )


def _draw_measurement_and_vehicle(rng: np.random.Generator) -> tuple[ConcealedEffect, ...]:
    """Draw one effect of the measurement (such as a pose latency) and one of the vehicle or floor, at random sizes."""
    vehicle_effects = [n for n in SIZE_RANGES if n not in MEASUREMENT_EFFECTS]
    names = [str(rng.choice(group)) for group in (MEASUREMENT_EFFECTS, vehicle_effects)]
    return tuple(draw_concealed_effect(name, rng, USUAL_CASE.duration_s) for name in names)


def thin_tiers(cases: list[BlindCase], every: int) -> list[BlindCase]:
    """Keep the first, and then each `every`-th, case of each tier (kind of blind case); nothing is random."""
    chosen = []
    for tier in dict.fromkeys(c.tier for c in cases):
        chosen += [c for c in cases if c.tier == tier][::every]
    return chosen


QUICK_STRIDES = {
    "single": 30, "single-imperfect": 60, "null": 100, "null-imperfect": 100, "left-out": 20, "pair": 50, "outside": 40,
    "unexcited": 6, "closed-loop": 20, "two-minutes": 11, "small-exact": 99, "small-wrong": 99,
}  # fmt: skip
"""A quick suite has about one case in so many of each tier, and at least one: twenty in all."""


def draw_quick_suite(cases: Sequence[BlindCase], seed: int) -> list[BlindCase]:
    """Draw about twenty of the `cases` at random: one in QUICK_STRIDES[tier] of each tier (kind of case) listed.

    Cases of one tier conceal different effects where there are enough different ones.
    """
    drawn = list[BlindCase]()
    for k, (tier, every) in enumerate(QUICK_STRIDES.items()):
        members = [c for c in cases if c.tier == tier]
        shuffled = [members[i] for i in np.random.default_rng([seed, k, 5]).permutation(len(members))]
        different = list({c.answer: c for c in shuffled}.values())
        few = max(len(members[every // 2 :: every]), min(len(members), 1))
        drawn += (different if len(different) >= few else shuffled)[:few]
    return drawn
