"""Newton steps on the marginal likelihood: where a refit stands, how predictions answer there, where a step leads."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from bcid.likelihood.free_part import badness, residuals, settled, without_pushes
from bcid.likelihood.hypothesis import Hypothesis
from bcid.likelihood.marginal import Eliminated, Scales, log_likelihood, moments, products, rescaled, weights
from bcid.likelihood.segments import wrapped
from bcid.likelihood.take import Floats, Take

STEP_PHI = 1e-3  # of base parameters, for differences
STEP_EFFECT = 0.05  # of an effect's size: some effects have kinks that a smaller step would not meet
LONGEST_STEP = 3.0  # of any component of phi
EM_STEPS, MOST_EM_STEPS = 2, 20  # on the way along a tangent, and where the scales are to settle
CONVERGED = 0.3  # nats, below which a step has gained nothing


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
    """D prediction / d phi (N, 3, n) of the components `which` (all), by differences from `r`, the residual at phi."""
    _, high = hypothesis.bounds()
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
    return A, as_it_is(of, found(of, phi, start, scales, r, A, em))


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
