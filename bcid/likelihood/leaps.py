"""The refit where predictions are made under pushes: every step of phi is followed by the pushes settling anew.

Pushes that do the work of what is missing make a tangent hold for hardly any way, and a valley of it runs straight
for long: what a force lacks goes over into the effect that it is, push by push.  So a Newton step is judged after
the free parts have settled (`bcid.likelihood.free_part`), and one that goes on as the last one did is stretched.
"""

from __future__ import annotations

import numpy as np

from bcid.likelihood.marginal import Scales
from bcid.likelihood.newton import Problem, State, Tangent, settled_at, slope_and_curvature, within
from bcid.likelihood.take import Floats

DAMPINGS = (0.0, 10.0, 1e3)  # of steps in phi, of which all components are of size one
STRAIGHT = 0.9  # cosine between steps of which the second goes on as the first did
SLACK = 3.0  # nats by which settling anew makes the same parameters better or worse
GAINED = 0.3  # nats
PATIENCE = 3  # leaps without a gain

_Found = tuple[Tangent, State]


def leapt(of: Problem, phi: Floats, start: Floats, scales: Scales, leaps: int) -> _Found:
    """The best state within so many leaps from phi, and the tangent there.

    Raises:
        FloatingPointError: where predictions leave the finite numbers at phi.
    """
    best = now = settled_at(of, phi, start, scales)
    last, vain = None, 0
    for _ in range(leaps):
        leap = _leap(of, *now)
        if leap is None:
            break
        step = leap[1].phi - now[1].phi
        now = _stretched(of, now[1], leap) if last is not None and _straight(last, step) else leap
        last, vain = step, 0 if now[1].objective > best[1].objective + GAINED else vain + 1
        best = max(best, now, key=_objective)
        if vain == PATIENCE:
            break
    return best


def _objective(of: _Found) -> float:
    return of[1].objective


def _straight(last: Floats, step: Floats) -> bool:
    return float(last @ step) > STRAIGHT * float(np.linalg.norm(last) * np.linalg.norm(step))


def _leap(of: Problem, tangent: Tangent, now: State) -> _Found | None:
    """Where the first damped Newton step leads that is hardly worse; or none."""
    slope, curvature = slope_and_curvature(of, tangent, now)
    for damping in DAMPINGS:
        phi = within(now.phi, slope, curvature + damping * np.eye(len(curvature)), of.hypothesis.bounds())
        there = _tried(of, phi, now)
        if there and there[1].objective > now.objective - SLACK:
            return there
    return None


def _stretched(of: Problem, before: State, leap: _Found) -> _Found:
    """The leap, or twice, four times as far, as long as that is better."""
    step, times = leap[1].phi - before.phi, 2.0
    while further := _tried(of, np.clip(before.phi + times * step, *of.hypothesis.bounds()), leap[1]):
        if further[1].objective <= leap[1].objective:
            break
        leap, times = further, 2.0 * times
    return leap


def _tried(of: Problem, phi: Floats, near: State) -> _Found | None:
    """`settled_at` from the free parts of a state nearby, or nothing where a step too long left the finite numbers."""
    try:
        return settled_at(of, phi, near.start, near.scales)
    except FloatingPointError:
        return None
