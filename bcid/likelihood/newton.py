"""Newton steps on the marginal likelihood: where a refit stands, how predictions answer there, where a step leads."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from bcid.aliases import Bools, Floats
from bcid.likelihood.hypothesis import Hypothesis
from bcid.likelihood.marginal import (
    Eliminated,
    Scales,
    eliminate,
    log_likelihood,
    moments,
    products,
    rescaled,
    weights,
)
from bcid.likelihood.nuisance import badness, moved, residuals, sensitivities, settled, without_pushes
from bcid.likelihood.predict import wrapped
from bcid.likelihood.take import Take

STEP_PHI = 1e-3  # of base parameters, for differences
STEP_EFFECT = 0.05  # of an effect's size: some effects have kinks that a smaller step would not meet
LONGEST_STEP = 3.0  # of any component of phi
EM_STEPS, MOST_EM_STEPS = 2, 20  # on the way along a tangent, and where the scales are to settle
CONVERGED = 0.3  # nats, below which a step has gained nothing
STRAYED = 4.0  # chi^2 for each number measured (about 1 is expected) from which a segment may have lost its beginning
THROWN = 3.0  # nats that a segment loses by a step of its own, beyond which its tangent has misled it
MOST_STRAYED = 0.1  # share of the segments beyond which it is the parameters' fault, not theirs
BEGINNINGS = 3  # tangents from which such a segment begins anew


class Tangent(NamedTuple):
    """How predictions answer near a fit."""

    A: Floats  # (N, 3, N_FREE) to free parts
    J: Floats  # (N, 3, base_size) to the base parameters


class Prior(NamedTuple):
    """Of phi (`Hypothesis.prior`)."""

    centre: Floats
    stiffness: Floats

    def __call__(self, phi: Floats) -> float:
        """Logarithm of its density, less a constant."""
        return -0.5 * float(np.sum(self.stiffness * (phi - self.centre) ** 2))


class Problem(NamedTuple):
    """What is fitted to what."""

    take: Take
    hypothesis: Hypothesis
    prior: Prior

    def residuals(self, phi: Floats, start: Floats) -> Floats:
        """`residuals` at phi."""
        return residuals(self.take, self.hypothesis.setting(phi, self.take), start)

    def objective(self, phi: Floats, e: Eliminated) -> float:
        """Log-likelihood and prior."""
        return float(log_likelihood(e).sum()) + self.prior(phi)


class State(NamedTuple):
    """Where a refit stands."""

    phi: Floats
    start: Floats
    scales: Scales
    r: Floats
    e: Eliminated
    objective: float  # log-likelihood and prior


def jacobian(
    take: Take, hypothesis: Hypothesis, phi: Floats, start: Floats, r: Floats, which: range | None = None
) -> Floats:
    """D prediction / d phi (N, 3, n) of the components `which` (all), by differences from `r`, the residual at phi.

    Differences go where a simulation's parameters are trusted no more: back from there might be an effect that is off.
    """
    _, high = hypothesis.usual_bounds()
    columns = []
    for j in which if which is not None else range(hypothesis.size):
        width = STEP_PHI if j < hypothesis.base_size else STEP_EFFECT
        moved = phi.copy()
        moved[j] += width if phi[j] + width <= high[j] else -width
        columns.append(wrapped(r - residuals(take, hypothesis.setting(moved, take), start)) / (moved[j] - phi[j]))
        if not np.isfinite(columns[-1]).all():  # LAPACK would not come back from it
            raise FloatingPointError("a prediction left the finite numbers")
    return np.stack(columns, axis=2) if columns else np.zeros((*r.shape, 0))


def settled_at(of: Problem, phi: Floats, start: Floats, scales: Scales, em: int = EM_STEPS) -> tuple[Tangent, State]:
    """The tangent at phi, and the state by it.

    Raises:
        FloatingPointError: where predictions leave the finite numbers.
    """
    A, now = standing_at(of, phi, start, scales, em)
    return tangent_at(of, A, now), now


def standing_at(of: Problem, phi: Floats, start: Floats, scales: Scales, em: int) -> tuple[Floats, State]:
    """How predictions answer to free parts (N, 3, N_FREE) that have settled at phi, and the state by it.

    Raises:
        FloatingPointError: where predictions leave the finite numbers.
    """
    start, r, A = settled(of.take, of.hypothesis.setting(phi, of.take), start, scales)
    now = found(of, phi, start, scales, r, A, em)
    return (A, as_it_is(of, now)) if of.take.pushed else _begun_anew(of, A, now, em)


def moved_unless_thrown(of: Problem, A: Floats, now: State) -> State:
    """The state with initial states at the posterior's mean, but of those segments that are thrown off by it.

    Each for itself: one of four hundred that a kink throws out of its way would hold all the others where they are.
    All that lose little by it are moved as well: of two tangents the likelier one errs in its own favour.
    """
    start = moved(of.take, now.start, now.e.z)
    r = of.residuals(now.phi, start)
    e = _by(A, start, r, of.take, now.scales)
    there = State(now.phi, start, now.scales, r, e, now.objective)
    return _mixed(of, _gains(e, now.e) > -THROWN, there, now)


def _begun_anew(of: Problem, A: Floats, now: State, em: int) -> tuple[Floats, State]:
    """The tangent `A` and the state with segments that have strayed begun anew where the recording has them.

    Where that is much likelier, each for itself.  Once its initial state is far off, a segment's tangent leads nowhere.
    """
    strayed = np.flatnonzero(~(now.e.chi2 < STRAYED * now.e.numbers))
    if not 0 < len(strayed) <= MOST_STRAYED * of.take.segments:
        return A, now
    part, rows, setting = of.take.part(strayed), of.take.rows(strayed), of.hypothesis.setting(now.phi, of.take)
    start, all_starts, all_r, A = part.start, now.start.copy(), now.r.copy(), A.copy()
    best = Eliminated(*(of_all[strayed] for of_all in now.e))
    for _ in range(BEGINNINGS):
        r, answer = residuals(part, setting, start), sensitivities(part, setting, start)
        e = _by(answer, start, r, part, now.scales)
        better = ~(_gains(e, best) < THROWN) & np.isfinite(e.chi2)
        to, of_part = rows[part.rows(np.flatnonzero(better))], part.rows(np.flatnonzero(better))
        all_starts[strayed[better]], all_r[to], A[to] = start[better], r[of_part], answer[of_part]
        best = _either(better, e, best)
        start = np.where(np.isfinite(e.z).all(axis=1, keepdims=True), moved(part, start, e.z), start)
    return A, found(of, now.phi, all_starts, now.scales, all_r, A, em)


def _by(A: Floats, start: Floats, r: Floats, take: Take, scales: Scales) -> Eliminated:
    """The likelihood's terms; NaN of segments whose predictions have left the finite numbers."""
    return eliminate(moments(without_pushes(r, A, start, take.first), A, take.first), scales.r, scales.precisions())


def _gains(one: Eliminated, other: Eliminated) -> Floats:
    """Nats by which each segment (S,) is the likelier by the `one`; NaN of what has left the numbers."""
    with np.errstate(invalid="ignore"):
        return log_likelihood(one) - log_likelihood(other)


def _either(first: Bools, one: Eliminated, other: Eliminated) -> Eliminated:
    """Of the segments marked `first` (S,) the one, of the rest the other."""
    return Eliminated(
        *(np.where(first.reshape(-1, *(1,) * (a.ndim - 1)), a, b) for a, b in zip(one, other, strict=True))
    )


def _mixed(of: Problem, first: Bools, one: State, other: State) -> State:
    """The same of states at one phi and with one set of scales."""
    rows, e = np.repeat(first, np.diff(of.take.first)), _either(first, one.e, other.e)
    start, r = np.where(first[:, None], one.start, other.start), np.where(rows[:, None], one.r, other.r)
    return other._replace(start=start, r=r, e=e, objective=of.objective(other.phi, e))


def tangent_at(of: Problem, A: Floats, now: State) -> Tangent:
    """The tangent at `now`, whose answer to free parts is `A`.

    Raises:
        FloatingPointError: where predictions leave the finite numbers.
    """
    return Tangent(A, jacobian(of.take, of.hypothesis, now.phi, now.start, now.r, range(of.hypothesis.base_size)))


def found(of: Problem, phi: Floats, start: Floats, scales: Scales, r: Floats, A: Floats, em: int = EM_STEPS) -> State:
    """The scales and the objective at phi, with the residual `r` and the tangent `A` at `start`.

    Raises:
        FloatingPointError: where a prediction or a scale is not finite.
    """
    scales, e = rescaled(moments(without_pushes(r, A, start, of.take.first), A, of.take.first), scales, em)
    return State(phi, start, scales, r, e, of.objective(phi, e))


def as_it_is(of: Problem, now: State) -> State:
    """The state, where predictions are made under pushes with every segment as it is.

    A tangent promises what a segment that settles slowly has not come to.
    """
    if not of.take.pushed:
        return now
    e = now.e._replace(chi2=badness(of.take, now.start, now.r, now.scales))
    return now._replace(e=e, objective=of.objective(now.phi, e))


def slope_and_curvature(of: Problem, tangent: Tangent, now: State) -> tuple[Floats, Floats]:
    """Slope (n,) and curvature (n, n) of the objective at `now`; effects' own columns are found there."""
    hypothesis, prior, first = of.hypothesis, of.prior, of.take.first
    own = jacobian(of.take, hypothesis, now.phi, now.start, now.r, range(hypothesis.base_size, hypothesis.size))
    J = np.concatenate([tangent.J, own], axis=2)
    r = without_pushes(now.r, tangent.A, now.start, first)
    g, G = products(r, tangent.A, J, first, now.scales.r, now.e.V)
    w = weights(now.e)
    return (
        w @ g - prior.stiffness * (now.phi - prior.centre),
        np.tensordot(w, G, axes=1) + np.diag(prior.stiffness),
    )


def within(phi: Floats, slope: Floats, curvature: Floats, bounds: tuple[Floats, Floats]) -> Floats:
    """Where a Newton step leads; what would leave its bounds stays there, and the others go on without it.

    So they do without what has no room between its bounds.
    """
    low, high = bounds
    free, after = low < high, phi.copy()
    while free.any():
        rest = slope - curvature[:, ~free] @ (after - phi)[~free]
        change = np.linalg.lstsq(curvature[np.ix_(free, free)], rest[free], rcond=None)[0]
        after[free] = phi[free] + np.clip(change, -LONGEST_STEP, LONGEST_STEP)
        outside = free & ((after < low) | (after > high))
        if not outside.any():
            break
        after[outside] = np.clip(after, low, high)[outside]
        free &= ~outside
    return after
