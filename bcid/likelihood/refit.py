"""The joint refit of base parameters and effects: Gauss-Newton on the marginal likelihood, robust over segments."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from bcid.likelihood.free_part import moved, residuals, settled, without_pushes
from bcid.likelihood.hypothesis import Hypothesis
from bcid.likelihood.marginal import Eliminated, Scales, log_likelihood, moments, products, rescaled, weights
from bcid.likelihood.segments import wrapped
from bcid.likelihood.take import Floats, Take
from bcid.physics.car import Car

STEP_PHI = 1e-3  # of base parameters, for differences
STEP_EFFECT = 0.05  # of an effect's size: some effects have kinks that a smaller step would not meet
MAX_ITERATIONS = 12  # along one tangent
TANGENTS = 24
SHORTER = (1.0, 0.3, 0.1, 0.03)  # of a step, where the whole of it leads astray
DAMPINGS = (0.0, 1.0, 10.0, 100.0, 1e3, 1e4, 1e5)
"""Of steps in phi, of which all components are of size one: what the take hardly shows is held back by it, and valleys
that logarithms of two parameters share stay open (scaled by the curvature's diagonal it would close them)."""
LONGEST_STEP = 3.0  # of any component of phi
CONVERGED = 0.3  # nats
FAR = 0.03  # a step of phi after which the tangent is found anew: 3 % of a base parameter
EM_STEPS = 2
LAST_EM_STEPS = 20
HELD_STEPS = 3  # after which initial states have settled


class Tangent(NamedTuple):
    """How predictions answer near a fit."""

    A: Floats  # (N, 3, N_FREE) to free parts
    J: Floats  # (N, 3, base_size) to the base parameters


@dataclass(frozen=True)
class Fit:
    """A hypothesis fitted to a take."""

    hypothesis: Hypothesis
    phi: Floats
    start: Floats  # (S, N_FREE) initial states, and pushes under which predictions are made
    scales: Scales
    log_likelihood: float  # sum over segments, without the prior
    per_segment: Floats  # (S,)
    covariance: Floats  # of phi
    tangent: Tangent

    @property
    def bic(self) -> float:
        """Log-likelihood less half a logarithm of the segments per effect parameter: more is better.

        Less, too, what it costs to leave the parameters of a simulation that is trusted.
        """
        extra = len(self.hypothesis.parameters)
        cost = 0.0 if self.hypothesis.simulated is None else _Prior(*self.hypothesis.prior(self.phi))(self.phi)
        return self.log_likelihood + cost - 0.5 * extra * float(np.log(len(self.per_segment)))

    def car(self) -> Car:
        """The fitted base parameters."""
        return self.hypothesis.car(self.phi)

    def values(self) -> dict[str, tuple[float, float]]:
        """Each effect parameter with its standard error, by field."""
        first = self.hypothesis.base_size
        se = np.sqrt(np.maximum(np.diag(self.covariance)[first:], 0.0)) * self.hypothesis.sizes()
        return {f: (v, float(s)) for (f, v), s in zip(self.hypothesis.values(self.phi).items(), se, strict=True)}


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


class _State(NamedTuple):
    """Where a refit stands."""

    phi: Floats
    start: Floats
    scales: Scales
    r: Floats
    e: Eliminated
    objective: float  # log-likelihood and prior


class _Prior(NamedTuple):
    """Of phi (`Hypothesis.prior`)."""

    centre: Floats
    stiffness: Floats

    def __call__(self, phi: Floats) -> float:
        return -0.5 * float(np.sum(self.stiffness * (phi - self.centre) ** 2))


def refit(
    take: Take, hypothesis: Hypothesis, phi: Floats, start: Floats, scales: Scales, iterations: int = MAX_ITERATIONS,
    known: Tangent | None = None, tangents: int = TANGENTS,
) -> Fit:  # fmt: skip
    """The likeliest phi from `phi`, with initial states and scales re-estimated on the way, along `tangents` at most.

    With `known`, a neighbouring fit's tangent stands throughout and only the effects' own columns are
    found anew: a tenth of the work, good enough to compare candidates, though parameters far from the neighbour
    come out biased.

    Raises:
        FloatingPointError: where predictions leave the finite numbers.
    """
    phi = np.clip(phi, *hypothesis.bounds())
    prior = _Prior(*hypothesis.prior(phi))
    if known is None:
        tangent, now = _settled(take, hypothesis, prior, phi, start, scales)
    else:
        tangent, r = known, residuals(take, hypothesis.setting(phi, take), start)
        now = _found(take, prior, phi, start, scales, r, tangent.A)
    best = tangent, now
    for _ in range(tangents if known is None else 1):
        anchor = now
        now = _along(take, hypothesis, prior, tangent, now, iterations, FAR if known is None else np.inf)
        if known is not None or now.objective - anchor.objective < CONVERGED:
            break
        fresh = _anew(take, hypothesis, prior, anchor, now)
        if fresh is None:
            now = anchor
            break
        tangent, now = fresh
        if now.objective > best[1].objective:
            best = fresh
    if known is None and best[1].objective > now.objective:
        tangent, now = best
    now = _found(take, prior, now.phi, now.start, now.scales, now.r, tangent.A, LAST_EM_STEPS)
    each = log_likelihood(now.e)
    _, curvature = _slope(take, hypothesis, prior, tangent, now)
    covariance = np.asarray(np.linalg.pinv(curvature), dtype=float)
    return Fit(hypothesis, now.phi, now.start, now.scales, float(each.sum()), each, covariance, tangent)


def _along(
    take: Take, hypothesis: Hypothesis, prior: _Prior, tangent: Tangent, now: _State, iterations: int, far: float
) -> _State:
    """Gauss-Newton steps along one tangent until none helps or one goes `far`."""
    for _ in range(iterations):
        slope, curvature = _slope(take, hypothesis, prior, tangent, now)
        before, now = now, _step(take, hypothesis, prior, now, tangent.A, slope, curvature)
        if now.objective - before.objective < CONVERGED or np.max(np.abs(now.phi - before.phi)) > far:
            break
    return now


def _slope(take: Take, hypothesis: Hypothesis, prior: _Prior, tangent: Tangent, now: _State) -> tuple[Floats, Floats]:
    """Slope (n,) and curvature (n, n) of the objective at `now`; effects' own columns are found there."""
    own = jacobian(take, hypothesis, now.phi, now.start, now.r, range(hypothesis.base_size, hypothesis.size))
    J = np.concatenate([tangent.J, own], axis=2)
    r = without_pushes(now.r, tangent.A, now.start, take.first)
    g, G = products(r, tangent.A, J, take.first, now.scales.r, now.e.V)
    w = weights(now.e)
    return (
        w @ g - prior.stiffness * (now.phi - prior.centre),
        np.tensordot(w, G, axes=1) + np.diag(prior.stiffness),
    )


def _anew(
    take: Take, hypothesis: Hypothesis, prior: _Prior, anchor: _State, ahead: _State
) -> tuple[Tangent, _State] | None:
    """The tangent at `ahead` and the state by it; nearer to `anchor` where by its own tangent it is no better.

    A tangent that is left far behind promises what is not there, of initial states above all.  Where an edge on the
    floor makes the likelihood rough, a refit goes on through its dents.
    """
    rough = any(p.places for _, p in hypothesis.parameters)
    for share in SHORTER:
        phi = anchor.phi + share * (ahead.phi - anchor.phi)
        start = anchor.start + share * (ahead.start - anchor.start)
        scales = ahead.scales if share == 1.0 else anchor.scales  # less noise suits what is ahead
        try:
            tangent, there = _settled(take, hypothesis, prior, phi, start, scales)
        except FloatingPointError:
            continue
        if rough or there.objective > anchor.objective:
            return tangent, there
    return None


def held(take: Take, hypothesis: Hypothesis, phi: Floats, scales: Scales) -> Fit:
    """What a simulation predicts that is not refitted: phi as it is, with free parts and scales found for it.

    Raises:
        FloatingPointError: where predictions leave the finite numbers.
    """
    start = take.start
    setting, free = hypothesis.setting(phi, take), _Prior(phi, np.zeros_like(phi))
    for _ in range(HELD_STEPS):
        start, r, A = settled(take, setting, start, scales)
        now = _found(take, free, phi, start, scales, r, A, LAST_EM_STEPS)
        start, scales = start if take.pushed else moved(take, start, now.e.z), now.scales
    tangent, now = _settled(take, hypothesis, free, phi, start, scales, LAST_EM_STEPS)
    each = log_likelihood(now.e)
    size = hypothesis.size
    return Fit(hypothesis, phi, now.start, now.scales, float(each.sum()), each, np.zeros((size, size)), tangent)


def _settled(
    take: Take, hypothesis: Hypothesis, prior: _Prior, phi: Floats, start: Floats, scales: Scales, em: int = EM_STEPS
) -> tuple[Tangent, _State]:
    """The tangent at phi, and the state by it."""
    start, r, A = settled(take, hypothesis.setting(phi, take), start, scales)
    tangent = Tangent(A, jacobian(take, hypothesis, phi, start, r, range(hypothesis.base_size)))
    return tangent, _found(take, prior, phi, start, scales, r, A, em)


def _found(
    take: Take, prior: _Prior, phi: Floats, start: Floats, scales: Scales, r: Floats, A: Floats, em: int = EM_STEPS
) -> _State:
    """The scales and the objective at phi."""
    scales, e = rescaled(moments(without_pushes(r, A, start, take.first), A, take.first), scales, em)
    return _State(phi, start, scales, r, e, float(log_likelihood(e).sum()) + prior(phi))


def _within(phi: Floats, slope: Floats, curvature: Floats, bounds: tuple[Floats, Floats]) -> Floats:
    """Where a Newton step leads; what would leave its bounds stays there, and the others go on without it."""
    low, high = bounds
    free, after = np.ones(len(phi), dtype=bool), phi.copy()
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


def _step(
    take: Take, hypothesis: Hypothesis, prior: _Prior, now: _State, A: Floats, slope: Floats, curvature: Floats
) -> _State:
    """The first damped step that raises the objective, with the initial states that go with it; or none."""
    bounds = hypothesis.bounds()
    for damping in DAMPINGS:
        phi = _within(now.phi, slope, curvature + damping * np.eye(len(curvature)), bounds)
        r = residuals(take, hypothesis.setting(phi, take), now.start)
        trial = _tried(take, prior, phi, now.start, now.scales, r, A, EM_STEPS)
        if trial and trial.objective > now.objective:
            start = moved(take, now.start, trial.e.z)
            r = residuals(take, hypothesis.setting(phi, take), start)
            there = _tried(take, prior, phi, start, trial.scales, r, A, 0)
            return there if there and there.objective > now.objective else trial
    return now


def _tried(
    take: Take, prior: _Prior, phi: Floats, start: Floats, scales: Scales, r: Floats, A: Floats, em: int
) -> _State | None:
    """`_found`, or nothing where a step too long has left the finite numbers."""
    try:
        return _found(take, prior, phi, start, scales, r, A, em)
    except FloatingPointError:
        return None
