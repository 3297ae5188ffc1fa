"""The refit where predictions are made under pushes: every step of phi is followed by the pushes settling anew.

Pushes that do the work of what is missing make a tangent hold for hardly any way, and a valley of it runs straight
for long: what a force lacks goes over into the effect that it is, push by push.  So a Newton step is judged after
the free parts have settled (`bcid.likelihood.nuisance`), and one that goes on as the last one did is stretched.
The scales settle with them, in turn: free parts found for large pushes are unlikely ones where pushes have become
rare, so that a step to what is missing would seem a loss, and a refit would stop short of its best.
"""

from __future__ import annotations

from contextlib import suppress
from typing import NamedTuple

import numpy as np

from bcid.aliases import Floats
from bcid.likelihood.marginal import Scales
from bcid.likelihood.newton import (
    CONVERGED,
    MOST_EM_STEPS,
    Problem,
    State,
    Tangent,
    slope_and_curvature,
    standing_at,
    tangent_at,
    within,
)

DAMPINGS = (0.0, 10.0, 1e3)  # of steps in phi, of which all components are of size one
NOWHERE = 1e-4  # of any component of phi, below which a step is none
STRAIGHT = 0.9  # cosine between steps of which the second goes on as the first did
SLACK = 3.0  # nats by which settling anew makes the same parameters better or worse
PATIENCE = 3  # leaps without a gain


class _Point(NamedTuple):
    """A state, and how the objective answers there."""

    tangent: Tangent
    state: State
    slope: Floats
    curvature: Floats


def leapt(of: Problem, phi: Floats, start: Floats, scales: Scales, leaps: int) -> tuple[Tangent, State]:
    """The best state within so many leaps from phi, and the tangent there.

    Raises:
        FloatingPointError: where predictions leave the finite numbers at phi.
    """
    best = now = _answering(of, *_standing(of, phi, start, scales))
    last, vain = None, 0
    for _ in range(leaps):
        leap = _leap(of, now)
        if leap is None:
            break
        step = leap.state.phi - now.state.phi
        now = _stretched(of, now.state, leap) if last is not None and _straight(last, step) else leap
        last, vain = step, 0 if now.state.objective > best.state.objective + CONVERGED else vain + 1
        best = max(best, now, key=lambda point: point.state.objective)
        if vain == PATIENCE:
            break
    return best.tangent, best.state


def _straight(last: Floats, step: Floats) -> bool:
    return float(last @ step) > STRAIGHT * float(np.linalg.norm(last) * np.linalg.norm(step))


def _leap(of: Problem, now: _Point) -> _Point | None:
    """Where the first damped Newton step leads that is hardly worse; or none."""
    phi = now.state.phi
    for damping, bounds in _ways(of, phi):
        ahead = within(phi, now.slope, now.curvature + damping * np.eye(len(phi)), bounds)
        if np.max(np.abs(ahead - phi)) < NOWHERE:
            break
        there = _tried(of, ahead, now.state, now.state.objective - SLACK)
        if there:
            return there
    return None


def _ways(of: Problem, phi: Floats) -> list[tuple[float, tuple[Floats, Floats]]]:
    """Dampings and bounds of the steps that are tried from phi, the longest first.

    Over an edge on the floor no tangent holds: where places are not leapt to as they stand, all else goes on without.
    """
    low, high = of.hypothesis.bounds()
    placed = of.hypothesis.placed
    if not placed.any():
        return [(damping, (low, high)) for damping in DAMPINGS]
    there = np.where(placed, phi, low), np.where(placed, phi, high)
    return [(DAMPINGS[0], (low, high)), *((damping, there) for damping in DAMPINGS)]


def _stretched(of: Problem, before: State, leap: _Point) -> _Point:
    """The leap, or twice, four times as far, as long as that gains and the bounds let it."""
    step, times, bounds = leap.state.phi - before.phi, 2.0, of.hypothesis.bounds()
    while True:
        ahead = np.clip(before.phi + times * step, *bounds)
        if np.max(np.abs(ahead - leap.state.phi)) < NOWHERE:
            return leap
        further = _tried(of, ahead, leap.state, leap.state.objective + CONVERGED)
        if further is None:
            return leap
        leap, times = further, 2.0 * times


def _tried(of: Problem, phi: Floats, near: State, least: float) -> _Point | None:
    """The point at phi from the free parts of a state nearby, if its objective is more than `least`.

    Nothing, too, where a step too long left the numbers.  How it answers to phi, half the work, is asked last.
    """
    try:
        A, now = _standing(of, phi, near.start, near.scales)
        return _answering(of, A, now) if now.objective > least else None
    except FloatingPointError:
        return None


def _standing(of: Problem, phi: Floats, start: Floats, scales: Scales) -> tuple[Floats, State]:
    """Where free parts and scales have settled at phi, and how predictions answer to free parts there.

    Free parts settle once more for the scales that were found with them; a third time gains little.
    """
    A, now = standing_at(of, phi, start, scales, MOST_EM_STEPS)
    with suppress(FloatingPointError):  # what has settled once stands
        anew, there = standing_at(of, phi, now.start, now.scales, MOST_EM_STEPS)
        if there.objective > now.objective + CONVERGED:
            return anew, there
    return A, now


def _answering(of: Problem, A: Floats, now: State) -> _Point:
    tangent = tangent_at(of, A, now)
    return _Point(tangent, now, *slope_and_curvature(of, tangent, now))
