"""Steps of initial states and pushes along one tangent: predictions anew at each, derivatives held fixed.

Each segment goes by itself.  A step is damped where a whole one leads astray (Levenberg 1944, Marquardt 1963).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from bcid.aliases import Bools, Floats, Ints
from bcid.likelihood import nuisance
from bcid.likelihood.marginal import MarginalTerms, student_log_densities
from bcid.likelihood.nuisance import AboutNuisances, posterior_step
from bcid.likelihood.refit_state import RefitProblem, RefitState, promised_to_all
from bcid.likelihood.state_segments import StateSegments, part_of, terms_along_tangent
from bcid.likelihood.take import select_spans

CHORDS = 5  # steps along one tangent
LEAST_DAMPING = 1e-3  # after the first step that has led astray
DAMPING_FACTOR = 10.0  # of the damping after a further one, and back after a tangent that led on
SETTLED_NATS = 0.05  # that the step of an initial state and pushes still promises, below which they stay
# Share of what a segment's first step promised that is still promised after it, below which its derivatives hold where
# it has led: in a diagnosis of 70 s of a small car's drive differentiating anew after 11,000 such steps changed a
# segment's likelihood by more than 0.01 nats once in a hundred.
HELD_SHARE = 1e-4


class TangentSteps(NamedTuple):
    """Where steps along a tangent have led some segments."""

    segments: StateSegments  # with the derivatives of the tangent
    start_densities: Floats  # (M,) joint log density of each where the tangent begins
    moved: Bools  # (M,)
    holds: Bools  # (M,) whether the first step shows that these derivatives are as good there
    damping: Floats  # (M,) of the next step


def step_along_tangent(problem: RefitProblem, state: RefitState, chosen: Ints, damping: Floats) -> TangentSteps:
    """The segments `chosen` after steps of their initial states and pushes, with the derivatives of `state` held fixed.

    Each step is damped by its segment's `damping` (M,): more after one after which it is worth less, which is taken
    back.  Once a segment has moved, a step that fails is the derivatives' fault.
    """
    at, damping = _segments_of(problem, state, chosen), damping.copy()
    promised = promised_to_all(at.terms, at.start)
    start_densities, first = joint_densities(at.terms, at.start), promised.copy()
    worth = start_densities.copy()
    moved, ended, holds = np.zeros((3, len(chosen)), dtype=bool)
    for _ in range(CHORDS):
        left = np.flatnonzero(~(ended | (promised < SETTLED_NATS)))
        if not len(left):
            break
        there = _step(problem, state, chosen[left], at.part(left), damping[left])
        now = joint_densities(there.terms, there.start)
        better = now > worth[left]
        to, failed = left[better], left[~better]
        at.replace_in_place(to, there, np.flatnonzero(better))
        worth[to], promised[to] = now[better], promised_to_all(part_of(at.terms, to), at.start[to])
        holds[to] |= ~moved[to] & np.isfinite(first[to]) & (promised[to] < HELD_SHARE * first[to])
        damping[failed] = np.where(moved[failed], damping[failed], more_damping(damping[failed]))
        ended[failed], moved[to] = moved[failed], True
    return TangentSteps(at, start_densities, moved, holds, damping)


def _segments_of(problem: RefitProblem, state: RefitState, chosen: Ints) -> StateSegments:
    """The segments `chosen` as they are in a refit's state."""
    rows, first = select_spans(problem.take.first, chosen)
    at = AboutNuisances(state.r[rows], state.A[rows])
    return StateSegments(first, state.start[chosen], at, part_of(state.terms, chosen))


def _step(problem: RefitProblem, state: RefitState, chosen: Ints, at: StateSegments, damping: Floats) -> StateSegments:
    """The segments `chosen`, which are `at` some initial states and pushes, after a damped step of these."""
    part, inputs = problem.take.part(chosen), problem.hypothesis.prediction_inputs(state.phi, problem.take)
    start = at.start + damped_step(at.start, at.terms, damping)
    r = nuisance.pose_residuals(part, inputs, start)
    terms = terms_along_tangent(at.at.A, r, start, part, state.scales)
    return StateSegments(at.first, start, AboutNuisances(r, at.at.A), terms)


def worths_there(terms: MarginalTerms, start: Floats) -> Floats:
    """Log-likelihood (S,) of each segment, less what a step from `start` promises: it has no more at `start` itself."""
    with np.errstate(invalid="ignore"):
        return student_log_densities(terms) - promised_to_all(terms, start)


def joint_densities(terms: MarginalTerms, start: Floats) -> Floats:
    """Log density (S,) of each segment's poses, initial state and pushes, but for a constant: what settling raises.

    It does not hang on the derivatives, as the likelihood does, which integrates over initial states and pushes.
    """
    return worths_there(terms, start) + 0.5 * terms.log_det


def damped_step(start: Floats, terms: MarginalTerms, damping: Floats) -> Floats:
    """The step (S, N_NUISANCE) of initial states and pushes from `start` to their posterior means, damped.

    It solves (M + damping diag M) step = M step_0, with the posterior precision M, the whole step step_0, and the
    `damping` (S,) of each segment.  A stiff car forgets how it slipped and turned within a few hundredths of a second:
    poses hardly show it, and the whole step leads so far that nothing is linear, while a share of it leaves all else
    where it was.
    """
    step = posterior_step(start, terms.z)
    finite = np.isfinite(terms.root).all(axis=(1, 2)) & np.isfinite(step).all(axis=1)
    chosen = np.flatnonzero(finite & (damping > 0.0))
    L = terms.L[chosen]
    M = L @ L.transpose(0, 2, 1)
    slope = L @ (L.transpose(0, 2, 1) @ step[chosen][:, :, None])
    damped = M + damping[chosen, None, None] * np.eye(M.shape[1]) * np.einsum("sii->si", M)[:, None, :]
    step[chosen] = np.linalg.solve(damped, slope)[:, :, 0]
    return step


def more_damping(damping: Floats) -> Floats:
    """The damping after a step that has led astray."""
    return np.maximum(LEAST_DAMPING, DAMPING_FACTOR * damping)


def less_damping(damping: Floats) -> Floats:
    """The damping after a tangent that led on: none below the least."""
    less = damping / DAMPING_FACTOR
    return np.where(less < LEAST_DAMPING, 0.0, less)
