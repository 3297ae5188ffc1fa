"""The Newton-Euler car with effects and what has no name, one period after the other, compiled.

What has no name acts in full where the drive was that it was found from, and fades beyond.  A period is integrated
without it and with it, and the two ends are mixed by the share w that it has at the period's beginning:

    w = exp(-sum_q d_q),    d_q the distance of quantity q from its range, over half of the range.
"""

import math
from typing import NamedTuple

import numpy as np

from bcid.aliases import Floats
from bcid.compiled.njit import njit
from bcid.effects.actuators import actuation_at
from bcid.effects.car import BodyState, LagState
from bcid.effects.unnamed_action import inputs_of_remainder
from bcid.models.newton_euler.augmented_step import (
    AugmentedSetup,
    AugmentedState,
    PeriodActuation,
    actuate_period,
    integrate_period,
    pack_carry,
    tracked_twist,
    unpack_carry,
)

LEAST_SHARE = 1e-6  # below which what has no name is not worth its time


class RemainderSetup(NamedTuple):
    """All that a step needs beside the carry: the car with its effects, without and with what has no name."""

    named: AugmentedSetup
    whole: AugmentedSetup
    driven: Floats  # (OF_THE_CAR, 2) ranges of the car's own inputs


@njit
def driven_share(state: AugmentedState, act: PeriodActuation, s: RemainderSetup) -> float:
    """The share (0 to 1) with which functions act at a state, as a period begins in which the actuators do `act`.

    It is 1 where all quantities of the car's own are in the ranges that were driven.
    """
    now = actuation_at(0, act.chain, s.named.T)
    at, away = inputs_of_remainder(now, state.body, s.named.car, s.named.switches), 0.0
    for q in range(len(s.driven)):
        low, high = s.driven[q, 0], s.driven[q, 1]
        away += max(low - at[q], at[q] - high, 0.0) / (0.5 * (high - low))
    return math.exp(-away)


@njit
def mix_states(one: AugmentedState, other: AugmentedState, share: float) -> AugmentedState:
    """The state between `one` and an `other` of the same car at the same time; a `share` of 1 is the other."""
    a, b, m, n = one.body, other.body, one.lagged, other.lagged
    body = BodyState(
        a.p_x + share * (b.p_x - a.p_x), a.p_y + share * (b.p_y - a.p_y), a.theta + share * (b.theta - a.theta),
        a.v_x + share * (b.v_x - a.v_x), a.v_y + share * (b.v_y - a.v_y), a.omega + share * (b.omega - a.omega),
    )  # fmt: skip
    lagged = LagState(
        m.alpha_f + share * (n.alpha_f - m.alpha_f), m.F_mf + share * (n.F_mf - m.F_mf),
        m.F_mr + share * (n.F_mr - m.F_mr),
    )  # fmt: skip
    return AugmentedState(body, lagged, one.servo, one.t, one.commands)


@njit
def advance_with_remainder(state: AugmentedState, parts: Floats, s: RemainderSetup) -> AugmentedState:
    """State of the car one period after `state` under the period's commands `parts` (W, 4)."""
    act = actuate_period(state, parts, s.named)
    share = driven_share(state, act, s)
    if share == 1.0:
        return integrate_period(state, act, s.whole)
    named = integrate_period(state, act, s.named)
    if share < LEAST_SHARE:
        return named
    return mix_states(named, integrate_period(state, act, s.whole), share)


@njit
def scan_with_remainder(carry: Floats, parts: Floats, s: RemainderSetup) -> Floats:
    """Twists (N, 3) of the car, at the tracked point and in its axes, after each of N periods.

    `carry` and commands `parts` (N, W, 4) are those of `scan_augmented`; the carry is advanced in place.
    """
    twists = np.empty((len(parts), 3))
    state = unpack_carry(carry)
    for k in range(len(parts)):
        state = advance_with_remainder(state, parts[k], s)
        twists[k, 0], twists[k, 1], twists[k, 2] = tracked_twist(state.body, s.named.switches)
    carry[:] = pack_carry(state)
    return twists
