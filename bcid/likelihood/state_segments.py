"""Some segments of a refit's state: predicted from other initial states and pushes, and put back into the state."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from bcid.aliases import Bools, Floats, Ints
from bcid.likelihood import marginal, nuisance
from bcid.likelihood.marginal import MarginalTerms, segment_moments, student_log_densities
from bcid.likelihood.nuisance import AboutNuisances, about_no_pushes
from bcid.likelihood.refit_state import RefitProblem, RefitState
from bcid.likelihood.scales import Scales
from bcid.likelihood.take import Take, select_spans


class StateSegments(NamedTuple):
    """Some segments of a take, linearised about other initial states than a refit's state has."""

    first: Ints  # (M + 1,) of M segments, rows from first[m] to first[m + 1]
    start: Floats  # (M, N_NUISANCE)
    at: AboutNuisances
    terms: MarginalTerms

    def part(self, chosen: Ints) -> StateSegments:
        """Those of the segments that are `chosen`."""
        rows, first = select_spans(self.first, chosen)
        at = AboutNuisances(*(array[rows] for array in self.at))
        return StateSegments(first, self.start[chosen], at, part_of(self.terms, chosen))

    def replace_in_place(self, into: Ints, new: StateSegments, chosen: Ints) -> None:
        """Replace the segments `into` by the `chosen` ones of `new`, of the same tangent, all but their derivatives.

        The caller must own the arrays: those of a part do, those of a kept state do not.
        """
        rows, new_rows = select_spans(self.first, into)[0], select_spans(new.first, chosen)[0]
        self.start[into], self.at.r[rows] = new.start[chosen], new.at.r[new_rows]
        for whole, part in zip(self.terms, new.terms, strict=True):
            whole[into] = part[chosen]


def linearise_from(problem: RefitProblem, state: RefitState, chosen: Ints, start: Floats) -> StateSegments:
    """The segments `chosen` predicted from other initial states `start` (M, N_NUISANCE), and differentiated there.

    Where a prediction is not finite the terms are NaN.
    """
    part, inputs = problem.take.part(chosen), problem.hypothesis.prediction_inputs(state.phi, problem.take)
    at = nuisance.linearise_nuisances(part, inputs, start)
    return StateSegments(part.first, start, at, terms_along_tangent(at.A, at.r, start, part, state.scales))


def put_segments(problem: RefitProblem, state: RefitState, into: Ints, new: StateSegments) -> RefitState:
    """The refit's state with the segments `into` replaced by `new` ones."""
    if not len(into):
        return state
    rows = problem.take.rows(into)
    start, r, A = state.start.copy(), state.r.copy(), state.A.copy()
    start[into], r[rows], A[rows] = new.start, new.at.r, new.at.A
    terms = MarginalTerms(*(_put(old, into, of_part) for old, of_part in zip(state.terms, new.terms, strict=True)))
    return state._replace(start=start, r=r, A=A, terms=terms, objective=problem.objective(state.phi, terms))


def terms_along_tangent(A: Floats, r: Floats, start: Floats, take: Take, scales: Scales) -> MarginalTerms:
    """Marginal likelihood terms of segments, predictions being linear in initial states and pushes.

    `r` (N, 3) is measured less predicted poses from `start`, `A` (N, 3, N_NUISANCE) are the derivatives of predicted
    ones.  The terms (chi^2, log-determinant, posterior) are NaN in segments whose prediction is not finite.
    """
    moments = segment_moments(about_no_pushes(r, A, start, take.first), A, take.first)
    return marginal.eliminate_nuisance(moments, scales.r, scales.nuisance_precision())


def segment_gains(new: MarginalTerms, old: MarginalTerms) -> Floats:
    """Log-likelihood gain (S,) in nats of each segment from `old` to `new` terms; NaN where either has diverged."""
    with np.errstate(invalid="ignore"):
        return student_log_densities(new) - student_log_densities(old)


def part_of(terms: MarginalTerms, chosen: Ints) -> MarginalTerms:
    """The terms of the segments `chosen`."""
    return MarginalTerms(*(term[chosen] for term in terms))


def _put(whole: Floats, into: Ints, part: Floats) -> Floats:
    """A copy of the array `whole` with `part` at its indices `into`."""
    changed = whole.copy()
    changed[into] = part
    return changed


def select_terms(mask: Bools, first: MarginalTerms, second: MarginalTerms) -> MarginalTerms:
    """Marginal likelihood terms from `first` in segments where `mask` (S,) is True, from `second` in the others."""
    pairs = zip(first, second, strict=True)
    return MarginalTerms(*(np.where(mask.reshape(-1, *(1,) * (a.ndim - 1)), a, b) for a, b in pairs))
