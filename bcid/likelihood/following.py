"""Initial states and pushes that go along with a step of the parameters, or to their posterior means."""

from __future__ import annotations

import itertools

import numpy as np

from bcid.aliases import Floats
from bcid.likelihood import nuisance
from bcid.likelihood.limits import SEGMENT_LIMITS
from bcid.likelihood.nuisance import posterior_step
from bcid.likelihood.refit_state import RefitProblem, RefitState
from bcid.likelihood.state_segments import part_of, segment_gains, select_terms, terms_along_tangent
from bcid.likelihood.take import N_START


def answer_parameters(problem: RefitProblem, state: RefitState, J: Floats) -> Floats:
    """What a step of phi does to the likeliest initial states and pushes (S, N_NUISANCE, n), to first order.

    It is -V A^T R^-1 J in each segment, with the derivatives A of the poses by initial states and pushes, those by phi
    in `J` (N, 3, n), and the posterior covariance V.
    """
    first, root = problem.take.first, state.terms.root
    out = np.empty((len(root), root.shape[1], J.shape[2]))
    for s, (a, b) in enumerate(itertools.pairwise(first)):
        weighted = state.A[a:b] / (state.scales.r**2)[:, None]
        out[s] = -root[s].T @ (root[s] @ np.tensordot(weighted, J[a:b], axes=((0, 1), (0, 1))))
    return out


def follow_parameters(problem: RefitProblem, state: RefitState, phi: Floats, answers: Floats) -> tuple[Floats, Floats]:
    """Initial states and pushes (S, N_NUISANCE) that go along with the parameters to `phi`, and the residual (N, 3).

    They move by `answers` (S, N_NUISANCE, n) per unit of phi (`answer_parameters`): from an initial state that stays, a
    car leaves the measured path farther than derivatives follow it.  What they would gain without any change of phi is
    left to other steps.  A segment that loses so stays where it began, if it is worth more there.
    """
    take, scales = problem.take, state.scales
    start = state.start + answers @ (phi - state.phi)
    r = problem.residuals(phi, start)
    terms = terms_along_tangent(state.A, r, start, take, scales)
    lost = np.flatnonzero(~(segment_gains(terms, state.terms) > -SEGMENT_LIMITS.max_loss_nats))
    if len(lost):
        part, rows, before = take.part(lost), take.rows(lost), state.start[lost]
        held = nuisance.pose_residuals(part, problem.hypothesis.prediction_inputs(phi, take), before)
        there = terms_along_tangent(state.A[rows], held, before, part, scales)
        better = np.isfinite(there.chi2) & ~(segment_gains(part_of(terms, lost), there) > 0.0)
        start[lost[better]] = before[better]
        own = np.repeat(better, np.diff(part.first))
        r[rows[own]] = held[own]
    return start, r


def move_initial_states(problem: RefitProblem, state: RefitState) -> RefitState:
    """The refit's state with segments' initial states moved to their posterior means, pushes held.

    Residuals are predicted anew, derivatives kept.  Each segment is decided by itself: it stays where it was if its
    log-likelihood falls by SEGMENT_LIMITS.max_loss_nats or more, or is not finite.
    """
    start = state.start + posterior_step(state.start, state.terms.z)
    start[:, N_START:] = state.start[:, N_START:]  # where derivatives are held, pushes are linear
    r = problem.residuals(state.phi, start)
    terms = terms_along_tangent(state.A, r, start, problem.take, state.scales)
    moves = segment_gains(terms, state.terms) > -SEGMENT_LIMITS.max_loss_nats
    rows, terms = np.repeat(moves, np.diff(problem.take.first)), select_terms(moves, terms, state.terms)
    start, r = np.where(moves[:, None], start, state.start), np.where(rows[:, None], r, state.r)
    return state._replace(start=start, r=r, terms=terms, objective=problem.objective(state.phi, terms))
