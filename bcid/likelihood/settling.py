"""Initial states and pushes of segments moved to where the take is likeliest, each segment by itself.

The likelihood integrates them out as if predictions were linear in them.  That is as good as the point about which
they are linearised: it has to lie where the likelihood by them is greatest, or a segment is promised too much.
"""

from __future__ import annotations

import numpy as np

from bcid.aliases import Floats, Ints
from bcid.likelihood.limits import SEGMENT_LIMITS
from bcid.likelihood.nuisance import AboutNuisances, without_pushes
from bcid.likelihood.refit_state import (
    RefitProblem,
    RefitState,
    build_state,
    promised_to_all,
    segment_worths,
)
from bcid.likelihood.state_segments import StateSegments, linearise_from, part_of, put_segments
from bcid.likelihood.take import N_START
from bcid.likelihood.tangent_steps import (
    SETTLED_NATS,
    joint_densities,
    less_damping,
    more_damping,
    step_along_tangent,
    worths_there,
)

SETTLING_TANGENTS = 12  # along which an initial state goes where the likelihood is greatest, at most
MOST_DAMPING = 1e3  # beyond which a segment stays where it is
LED_ON_NATS = 0.1 * SETTLED_NATS  # by which a tangent must lead a segment on for another one to be tried
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
    """The refit's state, each segment's initial state and pushes moved to where its likelihood is greatest nearby.

    Predictions are differentiated anew where steps have led, but for segments whose derivatives hold there.  A segment
    has settled where little is promised, and where a tangent has led it on for little.
    """
    found, damping, settled = state, np.zeros(problem.take.segments), np.zeros(problem.take.segments, dtype=bool)
    for _ in range(SETTLING_TANGENTS):
        unsettled = np.flatnonzero(~(settled | (damping > MOST_DAMPING) | (_unearned_nats(found) < SETTLED_NATS)))
        if not len(unsettled):
            break
        steps = step_along_tangent(problem, found, unsettled, damping[unsettled])
        damping[unsettled], held = steps.damping, np.flatnonzero(steps.holds)
        found = put_segments(problem, found, unsettled[held], steps.segments.part(held))
        anew = np.flatnonzero(steps.moved & ~steps.holds)
        if not len(anew):
            continue
        moving = unsettled[anew]
        moved = linearise_from(problem, found, moving, steps.segments.start[anew])
        gained = joint_densities(moved.terms, moved.start) - steps.start_densities[anew]
        better = gained > 0.0  # False where a prediction is not finite
        damping[moving] = np.where(better, less_damping(damping[moving]), more_damping(damping[moving]))
        # a damped step may gain little far below the top
        settled[moving] = better & (gained < LED_ON_NATS) & (damping[moving] == 0.0)
        found = put_segments(problem, found, moving[better], moved.part(np.flatnonzero(better)))
    return found


def _begin_without_pushes(problem: RefitProblem, state: RefitState) -> RefitState:
    """The refit's state without the pushes of segments that are worth more without."""
    far = np.flatnonzero(~(_unearned_nats(state) < FAR_NATS) & state.start[:, N_START:].any(axis=1))
    if not len(far):
        return state
    there = linearise_from(problem, state, far, without_pushes(state.start[far]))
    better = worths_there(there.terms, there.start) > worths_there(part_of(state.terms, far), state.start[far])
    return put_segments(problem, state, far[better], there.part(np.flatnonzero(better)))


def _unearned_nats(state: RefitState) -> Floats:
    """Nats (S,) that a step of initial state and pushes promises each segment of a refit's state."""
    return promised_to_all(state.terms, state.start)


def restart_misfitting_segments(problem: RefitProblem, state: RefitState, em_steps: int) -> RefitState:
    """The refit's state with badly fitting segments begun anew from initial states found in their measured poses.

    A segment fits badly if its chi^2 per measured number is SEGMENT_LIMITS.restart_chi2 or more.  Where it is begun
    anew it replaces the old one if it is worth at least SEGMENT_LIMITS.max_loss_nats more.
    """
    misfits = np.flatnonzero(~(state.terms.chi2 < SEGMENT_LIMITS.restart_chi2 * state.terms.numbers))
    if not len(misfits):
        return state
    there = _begin_by_pieces(problem, state, misfits)
    gained = segment_worths(there.terms) - segment_worths(part_of(state.terms, misfits))
    better = np.flatnonzero(~(gained < SEGMENT_LIMITS.max_loss_nats) & np.isfinite(there.terms.chi2))
    found = put_segments(problem, state, misfits[better], there.part(better))
    return _estimate_anew(problem, found, em_steps) if found is not state else state


def _begin_by_pieces(problem: RefitProblem, state: RefitState, chosen: Ints) -> StateSegments:
    """The segments `chosen`, their initial states and pushes found from their measured beginnings on, piece by piece.

    A car that turns round may be predicted anywhere after a second.  What comes later says where to go only once the
    poses before are followed.
    """
    part = problem.take.part(chosen)
    start = part.start
    for pieces in range(1, PIECES + 1):
        piece = problem._replace(take=part.beginnings(pieces / PIECES))
        there = linearise_from(piece, state, np.arange(len(chosen)), start)
        begun = state._replace(start=start, r=there.at.r, A=there.at.A, terms=there.terms)
        found = _settle(piece, begun)
        start = found.start
    return StateSegments(part.first, found.start, AboutNuisances(found.r, found.A), found.terms)


def _estimate_anew(problem: RefitProblem, state: RefitState, em_steps: int) -> RefitState:
    """The refit's state with the standard deviations of noise and pushes estimated anew in at most `em_steps`."""
    return build_state(problem, state.phi, state.start, state.scales, state.r, state.A, em_steps)
