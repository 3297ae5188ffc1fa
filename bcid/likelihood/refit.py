"""The joint refit of base parameters and effects: Gauss-Newton on the marginal likelihood, robust over segments."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bcid.aliases import Floats
from bcid.likelihood.hypothesis import Hypothesis
from bcid.likelihood.marginal import Scales, log_likelihood
from bcid.likelihood.newton import (
    CONVERGED,
    EM_STEPS,
    MOST_EM_STEPS,
    Prior,
    Problem,
    State,
    Tangent,
    as_it_is,
    found,
    moved_unless_thrown,
    settled_at,
    slope_and_curvature,
    standing_at,
    within,
)
from bcid.likelihood.nuisance import moved, settled
from bcid.likelihood.refit_with_pushes import leapt
from bcid.likelihood.take import Take
from bcid.physics.car import Car

MAX_ITERATIONS = 12  # along one tangent
TANGENTS = 24
SHORTER = (1.0, 0.3, 0.1, 0.03)  # of a step, where the whole of it leads astray
DAMPINGS = (0.0, 1.0, 10.0, 100.0, 1e3, 1e4, 1e5)
"""Of steps in phi, of which all components are of size one: what the take hardly shows is held back by it, and valleys
that logarithms of two parameters share stay open (scaled by the curvature's diagonal it would close them)."""
FAR = 0.03  # a step of phi after which the tangent is found anew: 3 % of a base parameter
HELD_STEPS = 3  # after which initial states have settled


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
        return self.log_likelihood + self.bent - 0.5 * extra * float(np.log(len(self.per_segment)))

    @property
    def bent(self) -> float:
        """Nats, less than nothing, that it costs to leave the parameters of a simulation that is trusted."""
        return 0.0 if self.hypothesis.simulated is None else Prior(*self.hypothesis.prior(self.phi))(self.phi)

    def car(self) -> Car:
        """The fitted base parameters."""
        return self.hypothesis.car(self.phi)

    def values(self) -> dict[str, tuple[float, float]]:
        """Each effect parameter with its standard error, by field."""
        first = self.hypothesis.base_size
        se = np.sqrt(np.maximum(np.diag(self.covariance)[first:], 0.0)) * self.hypothesis.sizes()
        return {f: (v, float(s)) for (f, v), s in zip(self.hypothesis.values(self.phi).items(), se, strict=True)}


def refit(
    take: Take, hypothesis: Hypothesis, phi: Floats, start: Floats, scales: Scales, iterations: int = MAX_ITERATIONS,
    known: Tangent | None = None, tangents: int = TANGENTS,
) -> Fit:  # fmt: skip
    """The likeliest phi from `phi`, with initial states and scales re-estimated on the way, along `tangents` at most.

    With `known`, a neighbouring fit's tangent stands throughout and only the effects' own columns are
    found anew: a tenth of the work, good enough to compare candidates, though parameters far from the neighbour
    come out biased.  Where predictions are made under pushes, every step settles anew: `tangents` counts them.

    Raises:
        FloatingPointError: where predictions leave the finite numbers.
    """
    phi = np.clip(phi, *hypothesis.bounds())
    of = Problem(take, hypothesis, Prior(*hypothesis.prior(phi)))
    if known is not None:
        tangent, r = known, of.residuals(phi, start)
        now = _along(of, tangent, found(of, phi, start, scales, r, tangent.A), iterations, np.inf)
    elif take.pushed:
        tangent, now = leapt(of, phi, start, scales, tangents)
    else:
        tangent, now = _by_tangents(of, phi, start, scales, iterations, tangents)
    now = found(of, now.phi, now.start, now.scales, now.r, tangent.A, MOST_EM_STEPS)
    if known is None:
        now = as_it_is(of, now)
    each = log_likelihood(now.e)
    _, curvature = slope_and_curvature(of, tangent, now)
    covariance = np.asarray(np.linalg.pinv(curvature), dtype=float)
    return Fit(hypothesis, now.phi, now.start, now.scales, float(each.sum()), each, covariance, tangent)


def _by_tangents(
    of: Problem, phi: Floats, start: Floats, scales: Scales, iterations: int, tangents: int
) -> tuple[Tangent, State]:
    """The best state along so many tangents, each found where the last one led, and its tangent."""
    tangent, now = best = settled_at(of, phi, start, scales)
    for _ in range(tangents):
        ahead = _along(of, tangent, now, iterations, FAR)
        if ahead.objective - now.objective < CONVERGED:
            now = ahead
            break
        fresh = _anew(of, now, ahead)
        if fresh is None:
            break
        tangent, now = fresh
        if now.objective > best[1].objective:
            best = fresh
    return best if best[1].objective > now.objective else (tangent, now)


def _along(of: Problem, tangent: Tangent, now: State, iterations: int, far: float) -> State:
    """Gauss-Newton steps along one tangent until none helps or one goes `far`."""
    for _ in range(iterations):
        slope, curvature = slope_and_curvature(of, tangent, now)
        before, now = now, _step(of, now, tangent.A, slope, curvature)
        if now.objective - before.objective < CONVERGED or np.max(np.abs(now.phi - before.phi)) > far:
            break
    return now


def _anew(of: Problem, anchor: State, ahead: State) -> tuple[Tangent, State] | None:
    """The tangent at `ahead` and the state by it; nearer to `anchor` where by its own tangent it is no better.

    A tangent that is left far behind promises what is not there, of initial states above all.  Where an edge on the
    floor makes the likelihood rough, a refit goes on through its dents.
    """
    rough = of.hypothesis.placed.any()
    for share in SHORTER:
        phi = ahead.phi if share == 1.0 else anchor.phi + share * (ahead.phi - anchor.phi)
        start = anchor.start + share * (ahead.start - anchor.start)
        scales = ahead.scales if share == 1.0 else anchor.scales  # less noise suits what is ahead
        try:
            tangent, there = settled_at(of, phi, start, scales)
        except FloatingPointError:
            continue
        if rough or there.objective > anchor.objective:
            return tangent, there
    return None


def standing(take: Take, hypothesis: Hypothesis, phi: Floats, start: Floats, scales: Scales) -> Floats:
    """Log-likelihood of every segment (S,) at phi, which is not refitted, with free parts and scales found for it.

    Raises:
        FloatingPointError: where predictions leave the finite numbers.
    """
    phi = np.clip(phi, *hypothesis.bounds())
    of = Problem(take, hypothesis, Prior(phi, np.zeros_like(phi)))
    return log_likelihood(standing_at(of, phi, start, scales, MOST_EM_STEPS)[1].e)


def held(take: Take, hypothesis: Hypothesis, phi: Floats, scales: Scales) -> Fit:
    """What a simulation predicts that is not refitted: phi as it is, with free parts and scales found for it.

    Raises:
        FloatingPointError: where predictions leave the finite numbers.
    """
    start = take.start
    setting, of = hypothesis.setting(phi, take), Problem(take, hypothesis, Prior(phi, np.zeros_like(phi)))
    for _ in range(HELD_STEPS):
        start, r, A = settled(take, setting, start, scales)
        now = found(of, phi, start, scales, r, A, MOST_EM_STEPS)
        start, scales = start if take.pushed else moved(take, start, now.e.z), now.scales
    tangent, now = settled_at(of, phi, start, scales, MOST_EM_STEPS)
    each = log_likelihood(now.e)
    size = hypothesis.size
    return Fit(hypothesis, phi, now.start, now.scales, float(each.sum()), each, np.zeros((size, size)), tangent)


def _step(of: Problem, now: State, A: Floats, slope: Floats, curvature: Floats) -> State:
    """The first damped step that raises the objective, with the initial states that go with it; or none."""
    bounds = of.hypothesis.bounds()
    for damping in DAMPINGS:
        phi = within(now.phi, slope, curvature + damping * np.eye(len(curvature)), bounds)
        trial = _tried(of, phi, now.start, now.scales, A, EM_STEPS)
        if trial and trial.objective > now.objective:
            there = moved_unless_thrown(of, A, trial)
            return there if there.objective > now.objective else trial
    return now


def _tried(of: Problem, phi: Floats, start: Floats, scales: Scales, A: Floats, em: int) -> State | None:
    """`found`, or nothing where a step too long has left the finite numbers."""
    try:
        return found(of, phi, start, scales, of.residuals(phi, start), A, em)
    except FloatingPointError:
        return None
