"""Initial states and pushes of segments moved to where the take is likeliest, each segment by itself.

The likelihood integrates them out as if predictions were linear in them.  That is as good as the point about which
they are linearised: it has to lie where the likelihood by them is greatest, or a segment is promised too much.
"""

from __future__ import annotations

import itertools
from typing import NamedTuple

import numpy as np

from bcid.aliases import Bools, Floats, Ints
from bcid.likelihood import marginal, nuisance
from bcid.likelihood.limits import SEGMENT_LIMITS
from bcid.likelihood.marginal import MarginalTerms, Scales, segment_moments, student_log_densities
from bcid.likelihood.nuisance import AboutNuisances, about_no_pushes, posterior_step, without_pushes
from bcid.likelihood.refit_state import (
    RefitProblem,
    RefitState,
    build_state,
    promised_to_all,
    segment_worths,
)
from bcid.likelihood.take import N_START, Take, select_spans

SETTLING_TANGENTS = 12  # along which an initial state goes where the likelihood is greatest, at most
CHORDS = 5  # steps along each, with derivatives held fixed
LEAST_DAMPING = 1e-3  # after the first step that has led astray
DAMPING_FACTOR = 10.0  # of the damping after a further one, and back after a tangent that led on
MOST_DAMPING = 1e3  # beyond which a segment stays where it is
SETTLED_NATS = 0.05  # that the step of an initial state and pushes still promises, below which they stay
PIECES = 3  # of a segment, in which a badly fitting one is followed from its beginning on
FAR_NATS = 5.0  # that are promised where a segment may do better without its pushes


def settle_initial_states(problem: RefitProblem, state: RefitState, em_steps: int) -> RefitState:
    """The refit's state with each segment's initial state and pushes moved to where its likelihood is greatest nearby.

    By Gauss-Newton steps, the predictions linearised anew after a few.  Segments that are far off begin without pushes
    where that is better: a hypothesis may need none where another had many.  Noise and pushes are estimated anew in at
    most `em_steps`.
    """
    found = _settle(problem, _begin_without_pushes(problem, state))
    return _estimate_anew(problem, found, em_steps) if found is not state else state


def _settle(problem: RefitProblem, state: RefitState) -> RefitState:
    """The refit's state, each segment's initial state and pushes moved to where its likelihood is greatest nearby."""
    found, damping = state, np.zeros(problem.take.segments)
    for _ in range(SETTLING_TANGENTS):
        unsettled = np.flatnonzero(~((damping > MOST_DAMPING) | (_unearned_nats(found) < SETTLED_NATS)))
        if not len(unsettled):
            break
        before = found.start[unsettled]
        start, damping[unsettled] = _settle_along_tangent(problem, found, unsettled, damping[unsettled])
        moves = (start != before).any(axis=1)
        moving = unsettled[moves]
        if not len(moving):
            continue
        moved = _linearise_from(problem, found, moving, start[moves])
        # False where a prediction is not finite
        better = _joint_densities(moved.terms, moved.start) > _joint_densities(
            _part_of(found.terms, moving), before[moves]
        )
        damping[moving] = np.where(better, _less_damping(damping[moving]), _more_damping(damping[moving]))
        found = _put_segments(problem, found, moving[better], moved.part(np.flatnonzero(better)))
    return found


def _begin_without_pushes(problem: RefitProblem, state: RefitState) -> RefitState:
    """The refit's state without the pushes of segments that are worth more without."""
    far = np.flatnonzero(~(_unearned_nats(state) < FAR_NATS) & state.start[:, N_START:].any(axis=1))
    if not len(far):
        return state
    there = _linearise_from(problem, state, far, without_pushes(state.start[far]))
    better = _worths_there(there.terms, there.start) > _worths_there(_part_of(state.terms, far), state.start[far])
    return _put_segments(problem, state, far[better], there.part(np.flatnonzero(better)))


def _unearned_nats(state: RefitState) -> Floats:
    """Nats (S,) that a step of initial state and pushes promises each segment of a refit's state."""
    return promised_to_all(state.terms, state.start)


def _worths_there(terms: MarginalTerms, start: Floats) -> Floats:
    """Log-likelihood (S,) of each segment, less what a step from `start` promises: it has no more at `start` itself."""
    with np.errstate(invalid="ignore"):
        return student_log_densities(terms) - promised_to_all(terms, start)


def _joint_densities(terms: MarginalTerms, start: Floats) -> Floats:
    """Log density (S,) of each segment's poses, initial state and pushes, but for a constant: what settling raises.

    It does not hang on the derivatives, as the likelihood does, which integrates over initial states and pushes.
    """
    return _worths_there(terms, start) + 0.5 * terms.log_det


def _settle_along_tangent(
    problem: RefitProblem, state: RefitState, chosen: Ints, damping: Floats
) -> tuple[Floats, Floats]:
    """Initial states and pushes (M, N_NUISANCE) of the segments `chosen` after steps with derivatives held fixed.

    Each step is damped by its segment's `damping` (M,): more after one after which it is worth less, which is taken
    back (Levenberg 1944, Marquardt 1963).  Once a segment has moved, a step that fails is the derivatives' fault.
    Returned is also the damping.
    """
    part, rows = problem.take.part(chosen), problem.take.rows(chosen)
    inputs, A = problem.hypothesis.prediction_inputs(state.phi, problem.take), state.A[rows]
    best, terms = state.start[chosen], _part_of(state.terms, chosen)
    worth, moved, ended = (
        _joint_densities(terms, best),
        np.zeros(len(chosen), dtype=bool),
        np.zeros(len(chosen), dtype=bool),
    )
    for _ in range(CHORDS):
        # one that has settled stays, whatever else is sought
        unsettled = ~(ended | (promised_to_all(terms, best) < SETTLED_NATS))
        if not unsettled.any():
            break
        start = best + damped_step(best, terms, damping)
        there = _terms_along_tangent(A, nuisance.pose_residuals(part, inputs, start), start, part, state.scales)
        now = _joint_densities(there, start)
        better = unsettled & (now > worth)
        failed = unsettled & ~better
        best, worth = np.where(better[:, None], start, best), np.where(better, now, worth)
        terms = _select_terms(better, there, terms)
        ended |= failed & moved
        damping = np.where(failed & ~moved, _more_damping(damping), damping)
        moved |= better
    return best, damping


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
    L = np.linalg.inv(terms.root[chosen])
    M = L @ L.transpose(0, 2, 1)
    slope = L @ (L.transpose(0, 2, 1) @ step[chosen][:, :, None])
    damped = M + damping[chosen, None, None] * np.eye(M.shape[1]) * np.einsum("sii->si", M)[:, None, :]
    step[chosen] = np.linalg.solve(damped, slope)[:, :, 0]
    return step


def _more_damping(damping: Floats) -> Floats:
    """The damping after a step that has led astray."""
    return np.maximum(LEAST_DAMPING, DAMPING_FACTOR * damping)


def _less_damping(damping: Floats) -> Floats:
    """The damping after a tangent that led on: none below the least."""
    less = damping / DAMPING_FACTOR
    return np.where(less < LEAST_DAMPING, 0.0, less)


def restart_misfitting_segments(problem: RefitProblem, state: RefitState, em_steps: int) -> RefitState:
    """The refit's state with badly fitting segments begun anew from initial states found in their measured poses.

    A segment fits badly if its chi^2 per measured number is SEGMENT_LIMITS.restart_chi2 or more.  Where it is begun
    anew it replaces the old one if it is worth at least SEGMENT_LIMITS.max_loss_nats more.
    """
    misfits = np.flatnonzero(~(state.terms.chi2 < SEGMENT_LIMITS.restart_chi2 * state.terms.numbers))
    if not len(misfits):
        return state
    there = _begin_by_pieces(problem, state, misfits)
    gained = segment_worths(there.terms) - segment_worths(_part_of(state.terms, misfits))
    better = np.flatnonzero(~(gained < SEGMENT_LIMITS.max_loss_nats) & np.isfinite(there.terms.chi2))
    found = _put_segments(problem, state, misfits[better], there.part(better))
    return _estimate_anew(problem, found, em_steps) if found is not state else state


def _begin_by_pieces(problem: RefitProblem, state: RefitState, chosen: Ints) -> _Segments:
    """The segments `chosen`, their initial states and pushes found from their measured beginnings on, piece by piece.

    A car that turns round may be predicted anywhere after a second.  What comes later says where to go only once the
    poses before are followed.
    """
    part = problem.take.part(chosen)
    start = part.start
    for pieces in range(1, PIECES + 1):
        piece = problem._replace(take=part.beginnings(pieces / PIECES))
        there = _linearise_from(piece, state, np.arange(len(chosen)), start)
        begun = state._replace(start=start, r=there.at.r, A=there.at.A, terms=there.terms)
        found = _settle(piece, begun)
        start = found.start
    return _Segments(part.first, found.start, AboutNuisances(found.r, found.A), found.terms)


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
    terms = _terms_along_tangent(state.A, r, start, take, scales)
    lost = np.flatnonzero(~(_segment_gains(terms, state.terms) > -SEGMENT_LIMITS.max_loss_nats))
    if len(lost):
        part, rows, before = take.part(lost), take.rows(lost), state.start[lost]
        held = nuisance.pose_residuals(part, problem.hypothesis.prediction_inputs(phi, take), before)
        there = _terms_along_tangent(state.A[rows], held, before, part, scales)
        better = np.isfinite(there.chi2) & ~(_segment_gains(_part_of(terms, lost), there) > 0.0)
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
    terms = _terms_along_tangent(state.A, r, start, problem.take, state.scales)
    moves = _segment_gains(terms, state.terms) > -SEGMENT_LIMITS.max_loss_nats
    rows, terms = np.repeat(moves, np.diff(problem.take.first)), _select_terms(moves, terms, state.terms)
    start, r = np.where(moves[:, None], start, state.start), np.where(rows[:, None], r, state.r)
    return state._replace(start=start, r=r, terms=terms, objective=problem.objective(state.phi, terms))


class _Segments(NamedTuple):
    """Some segments of a take, linearised about other initial states than a refit's state has."""

    first: Ints  # (M + 1,) of M segments, rows from first[m] to first[m + 1]
    start: Floats  # (M, N_NUISANCE)
    at: AboutNuisances
    terms: MarginalTerms

    def part(self, chosen: Ints) -> _Segments:
        """Those of the segments that are `chosen`."""
        rows, first = select_spans(self.first, chosen)
        at = AboutNuisances(*(array[rows] for array in self.at))
        return _Segments(first, self.start[chosen], at, _part_of(self.terms, chosen))


def _linearise_from(problem: RefitProblem, state: RefitState, chosen: Ints, start: Floats) -> _Segments:
    """The segments `chosen` predicted from other initial states `start` (M, N_NUISANCE), and differentiated there.

    Where a prediction is not finite the terms are NaN.
    """
    part, inputs = problem.take.part(chosen), problem.hypothesis.prediction_inputs(state.phi, problem.take)
    at = nuisance.linearise_nuisances(part, inputs, start)
    return _Segments(part.first, start, at, _terms_along_tangent(at.A, at.r, start, part, state.scales))


def _put_segments(problem: RefitProblem, state: RefitState, into: Ints, new: _Segments) -> RefitState:
    """The refit's state with the segments `into` replaced by `new` ones."""
    if not len(into):
        return state
    rows = problem.take.rows(into)
    start, r, A = state.start.copy(), state.r.copy(), state.A.copy()
    start[into], r[rows], A[rows] = new.start, new.at.r, new.at.A
    terms = MarginalTerms(*(_put(old, into, of_part) for old, of_part in zip(state.terms, new.terms, strict=True)))
    return state._replace(start=start, r=r, A=A, terms=terms, objective=problem.objective(state.phi, terms))


def _estimate_anew(problem: RefitProblem, state: RefitState, em_steps: int) -> RefitState:
    """The refit's state with the standard deviations of noise and pushes estimated anew in at most `em_steps`."""
    return build_state(problem, state.phi, state.start, state.scales, state.r, state.A, em_steps)


def _terms_along_tangent(A: Floats, r: Floats, start: Floats, take: Take, scales: Scales) -> MarginalTerms:
    """Marginal likelihood terms of segments, predictions being linear in initial states and pushes.

    `r` (N, 3) is measured less predicted poses from `start`, `A` (N, 3, N_NUISANCE) are the derivatives of predicted
    ones.  The terms (chi^2, log-determinant, posterior) are NaN in segments whose prediction is not finite.
    """
    moments = segment_moments(about_no_pushes(r, A, start, take.first), A, take.first)
    return marginal.eliminate_nuisance(moments, scales.r, scales.nuisance_precision())


def _segment_gains(new: MarginalTerms, old: MarginalTerms) -> Floats:
    """Log-likelihood gain (S,) in nats of each segment from `old` to `new` terms; NaN where either has diverged."""
    with np.errstate(invalid="ignore"):
        return student_log_densities(new) - student_log_densities(old)


def _part_of(terms: MarginalTerms, chosen: Ints) -> MarginalTerms:
    """The terms of the segments `chosen`."""
    return MarginalTerms(*(term[chosen] for term in terms))


def _put(whole: Floats, into: Ints, part: Floats) -> Floats:
    """A copy of the array `whole` with `part` at its indices `into`."""
    changed = whole.copy()
    changed[into] = part
    return changed


def _select_terms(mask: Bools, first: MarginalTerms, second: MarginalTerms) -> MarginalTerms:
    """Marginal likelihood terms from `first` in segments where `mask` (S,) is True, from `second` in the others."""
    pairs = zip(first, second, strict=True)
    return MarginalTerms(*(np.where(mask.reshape(-1, *(1,) * (a.ndim - 1)), a, b) for a, b in pairs))
