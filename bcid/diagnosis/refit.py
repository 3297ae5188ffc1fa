"""The joint refit of base parameters and effects: Gauss-Newton on the marginal likelihood, robust over segments."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from bcid.diagnosis.hypothesis import BASE, DRAG, PRIOR_SD, Hypothesis, Setting
from bcid.diagnosis.marginal import Eliminated, Scales, eliminate, log_likelihood, updated, weights
from bcid.diagnosis.segments import free_sensitivities, predict, wrapped
from bcid.diagnosis.take import Floats, Take
from bcid.effects.constants import Constants
from bcid.physics.car import Car

STEP_PHI = 1e-3  # of base parameters, for differences
STEP_EFFECT = 0.05  # of an effect's size: some effects have kinks that a smaller step would not meet
MAX_ITERATIONS = 25
DAMPINGS = (0.0, 0.03, 0.3, 3.0, 30.0)
CONVERGED = 0.1  # nats
EM_STEPS = 6
FIRST_ITERATIONS = 3
START_SHARES = (0.3, 1.5, -0.5)


@dataclass(frozen=True)
class Fit:
    """A hypothesis fitted to a take."""

    hypothesis: Hypothesis
    phi: Floats
    start: Floats  # (S, 6) initial states
    scales: Scales
    log_likelihood: float  # sum over segments, without the prior
    per_segment: Floats  # (S,)
    covariance: Floats  # of phi
    A: Floats  # (N, 3, N_FREE) the free sensitivities that it was fitted with

    @property
    def bic(self) -> float:
        """Log-likelihood less half a logarithm of the segments per effect parameter: more is better."""
        extra = len(self.hypothesis.parameters)
        return self.log_likelihood - 0.5 * extra * float(np.log(len(self.per_segment)))

    def values(self) -> dict[str, tuple[float, float]]:
        """Each effect parameter with its standard error, by field."""
        first = len(BASE) + len(DRAG)
        se = np.sqrt(np.maximum(np.diag(self.covariance)[first:], 0.0)) * self.hypothesis.units()
        return {f: (v, float(s)) for (f, v), s in zip(self.hypothesis.values(self.phi).items(), se, strict=True)}


def residuals(take: Take, setting: Setting, start: Floats) -> Floats:
    """Measured less predicted poses (N, 3)."""
    poses = predict(
        take.stamp_s, take.first, take.step, take.steps, start, setting.chain, take.T, setting.car, setting.switches,
        setting.constants,
    )  # fmt: skip
    return wrapped(take.pose - poses)


def jacobian(take: Take, hypothesis: Hypothesis, phi: Floats, start: Floats) -> Floats:
    """D prediction / d phi (N, 3, n) by central differences, one-sided at a bound."""
    low, high = hypothesis.bounds()
    columns = []
    base = len(BASE) + len(DRAG)
    for j in range(hypothesis.size):
        width = STEP_PHI if j < base else STEP_EFFECT
        ahead, behind = phi.copy(), phi.copy()
        ahead[j], behind[j] = min(phi[j] + width, high[j]), max(phi[j] - width, low[j])
        r_ahead, r_behind = (residuals(take, hypothesis.setting(x, take), start) for x in (ahead, behind))
        columns.append(wrapped(r_behind - r_ahead) / (ahead[j] - behind[j]))
    return np.stack(columns, axis=2)


def sensitivities(take: Take, setting: Setting, start: Floats) -> Floats:
    """D pose / d [initial state, pushes] (N, 3, N_FREE)."""
    return np.asarray(
        free_sensitivities(
            take.stamp_s, take.first, take.step, take.steps, start, setting.chain, take.T, setting.car,
            setting.switches, setting.constants,
        )
    )  # fmt: skip


def refit(
    take: Take, hypothesis: Hypothesis, phi: Floats, start: Floats, scales: Scales, iterations: int = MAX_ITERATIONS,
    known_A: Floats | None = None,
) -> Fit:  # fmt: skip
    """The likeliest phi from `phi`, with initial states and scales re-estimated on the way.

    Base parameters carry a weak prior about where the refit starts, for those that the take does not show.
    With `known_A`, the free sensitivities of a neighbouring fit stand throughout: they are the
    costliest part and good enough to compare rivals, but bias the parameters where the neighbour is far off.
    """
    low, high = hypothesis.bounds()
    centre = phi.copy()
    stiff = np.zeros(hypothesis.size)
    stiff[: len(BASE) + len(DRAG)] = 1.0 / PRIOR_SD**2
    poses = np.diff(take.first)
    A = sensitivities(take, hypothesis.setting(phi, take), start) if known_A is None else known_A
    best = -np.inf
    curvature = np.eye(hypothesis.size)
    e: Eliminated | None = None
    for _ in range(iterations):
        J = jacobian(take, hypothesis, phi, start)
        r = residuals(take, hypothesis.setting(phi, take), start)
        for _ in range(EM_STEPS):
            e = eliminate(r, A, J, take.first, scales.r, scales.free_variances())
            scales = updated(scales, e, poses)
        e = eliminate(r, A, J, take.first, scales.r, scales.free_variances())
        before = float(log_likelihood(e).sum()) - 0.5 * float(np.sum(stiff * (phi - centre) ** 2))
        w = weights(e)
        g = np.einsum("s,sn->n", w, e.g) - stiff * (phi - centre)
        curvature = np.einsum("s,snm->nm", w, e.G) + np.diag(stiff)
        phi, start, found = _step(
            take, hypothesis, phi, start, scales, A, g, curvature, before, (stiff, centre, low, high)
        )
        if found - best < CONVERGED:
            break
        best = found
        if known_A is None:
            A = sensitivities(take, hypothesis.setting(phi, take), start)
    r = residuals(take, hypothesis.setting(phi, take), start)
    none = np.zeros((*r.shape, 0))
    e = eliminate(r, A, none, take.first, scales.r, scales.free_variances())
    each = log_likelihood(e)
    covariance = np.asarray(np.linalg.pinv(curvature), dtype=float)
    return Fit(hypothesis, phi, start, scales, float(each.sum()), each, covariance, A)


def _step(
    take: Take, hypothesis: Hypothesis, phi: Floats, start: Floats, scales: Scales, A: Floats, g: Floats,
    curvature: Floats, before: float, prior: tuple[Floats, Floats, Floats, Floats],
) -> tuple[Floats, Floats, float]:  # fmt: skip
    """The first damped step that raises the likelihood, with the initial states that go with it."""
    stiff, centre, low, high = prior
    none = np.zeros((len(take.stamp_s), 3, 0))
    for damping in DAMPINGS:
        change = np.linalg.lstsq(curvature + damping * np.diag(np.diag(curvature) + 1e-9), g, rcond=None)[0]
        trial = np.clip(phi + np.clip(change, -3.0, 3.0), low, high)
        r = residuals(take, hypothesis.setting(trial, take), start)
        if not np.isfinite(r).all():
            continue
        e = eliminate(r, A, none, take.first, scales.r, scales.free_variances())
        after = float(log_likelihood(e).sum()) - 0.5 * float(np.sum(stiff * (trial - centre) ** 2))
        if after > before:
            return trial, start + e.z[:, :6], after
    return phi, start, before


def base_fit(take: Take, car: Car, angle_limit: float, constants: Constants, scales: Scales) -> Fit:
    """The base model without effects, refitted to the take."""
    hypothesis = Hypothesis((), car, angle_limit, constants)
    return refit(take, hypothesis, hypothesis.start(car), take.start, scales)


def with_effects(base: Fit, effects: tuple[str, ...], take: Take, nominal: Car | None = None) -> Fit:
    """The joint refit of the base model and `effects`, the best of several starts.

    The effects start at fractions and multiples of their sizes, of either sign where it may be; the base
    parameters at the refitted base, which may have swallowed the effect, and at the `nominal` car.  Each
    start goes a few steps, the likeliest goes on.
    """
    hypothesis = replace(base.hypothesis, effects=effects)
    cars = [base.hypothesis.car(base.phi), *([nominal] if nominal is not None else [])]
    tried = [
        refit(take, hypothesis, hypothesis.start(car, values), base.start, base.scales, FIRST_ITERATIONS, base.A)
        for car in cars
        for values in _starts(hypothesis)
    ]
    best = max(tried, key=lambda fit: fit.log_likelihood)
    return refit(take, hypothesis, best.phi, best.start, best.scales)


def _starts(hypothesis: Hypothesis) -> list[list[float]]:
    """Where the effects' parameters start; places start at the middle of what may be."""
    starts = []
    for share in START_SHARES:
        values = []
        for _, p in hypothesis.parameters:
            value = p.off if p.places else share * p.size
            values.append(min(max(value, p.low), p.high))
        if values not in starts:
            starts.append(values)
    return starts
