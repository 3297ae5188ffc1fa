"""The smallest size of each effect that a take would show, before anything is driven or fitted.

An effect shows where the expected gain of its refit, a^2 G / 2 with G the information about its amplitude a beside
the base parameters, reaches what a diagnosis requires: the usual gate, and half a logarithm of the number of segments
per parameter.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from bcid.aliases import Floats
from bcid.effects.entry import Effect, Parameter
from bcid.experiment.limits import EXPERIMENT_LIMITS
from bcid.likelihood.hypothesis import Hypothesis
from bcid.likelihood.jacobian import parameter_jacobian
from bcid.likelihood.limits import LIKELIHOOD_LIMITS
from bcid.likelihood.nuisance import linearise_nuisances, pose_residuals
from bcid.likelihood.price import price_nats
from bcid.likelihood.projection import linearise_fit, project_out_fit
from bcid.likelihood.refit import Fit
from bcid.likelihood.refit_state import Tangent
from bcid.likelihood.scales import Scales
from bcid.likelihood.score_test import compute_trial_changes, replace_value
from bcid.likelihood.take import Take

SIZE_ITERATIONS = 6  # of finding the smallest size: an effect need not grow with its square
MAX_SIZE_STEP = 4.0  # of the size in one round
SIZE_TOLERANCE = 0.02  # relative, at which the size is found
MAX_PLACES_PER_SIDE = 4  # along each side of the floor

Sizes = dict[str, tuple[float, str]]
"""Value and unit of each amplitude of an effect, by symbol."""


class PlacedAmplitude(NamedTuple):
    """One amplitude of an effect, with the effect at one place or time if it has any."""

    effect: str
    parameter_index: int  # of the amplitude among the effect's parameters
    parameter: Parameter
    values: list[float]  # of all the effect's parameters

    def with_size(self, size: float) -> PlacedAmplitude:
        """A copy of this amplitude with another size."""
        return self._replace(values=replace_value(self.values, self.parameter_index, size))


def amplitudes_at_typical_places(names: Sequence[str], take: Take, hypothesis: Hypothesis) -> list[PlacedAmplitude]:
    """List every strength parameter of the effects `names` at its declared size, once for each typical place or time.

    With each comes the full parameter vector of its effect: other strengths are off, and place or time parameters are
    chosen over the floor and the duration of the take.
    """
    entries = hypothesis.entries
    return [
        PlacedAmplitude(name, i, p, [place.get(q.symbol, q.off) for q in entries[name].parameters]).with_size(p.size)
        for name in names
        for place in _typical_places(entries[name], take)
        for i, p in enumerate(entries[name].parameters)
        if not p.is_place
    ]


def _typical_places(effect: Effect, take: Take) -> list[dict[str, float]]:
    """Typical values of an effect's place or time parameters in a take, as a list of dicts by symbol.

    A circle on the floor gets a grid of centres (x, y) with the default radius; a cable an anchor in the middle of
    each side of the floor; a change in time t_s = 30, 50 and 70 % of the longest recording.  [{}] for an effect
    without such parameters.
    """
    symbols = [p.symbol for p in effect.place_parameters]
    if not symbols:
        return [{}]
    if "t_s" in symbols:
        return [{"t_s": share * float(take.length_s.max())} for share in (0.3, 0.5, 0.7)]
    low, high = np.quantile(take.pose[:, :2], 0.02, axis=0), np.quantile(take.pose[:, :2], 0.98, axis=0)
    if "radius" in symbols:
        radius = next(p.size for p in effect.parameters if p.symbol == "radius")
        counts = np.clip(np.round((high - low) / (2.0 * radius)), 1, MAX_PLACES_PER_SIDE).astype(int)
        axes = [np.linspace(a, b, n + 2)[1:-1] for a, b, n in zip(low, high, counts, strict=True)]
        return [{"x": float(x), "y": float(y), "radius": radius} for x, y in itertools.product(*axes)]
    sides = [(0.0, 0.5), (1.0, 0.5), (0.5, 0.0), (0.5, 1.0)]
    slack = {p.symbol: p.size for p in effect.place_parameters if p.symbol == "r_0"}
    return [dict(zip("xy", (low + (high - low) * side).tolist(), strict=True)) | slack for side in sides]


def required_gain_nats(effect: Effect, segments: int, gate_nats: float = LIKELIHOOD_LIMITS.usual_gate_nats) -> float:
    """Expected log-likelihood gain (nats) that an effect needs to count as detectable: the gate, and its price.

    The gate is a gain that chance hardly reaches.
    """
    return gate_nats + price_nats(len(effect.parameters), segments)


def tangent_fit(hypothesis: Hypothesis, phi: Floats, scales: Scales, take: Take) -> Fit:
    """A `Fit` whose parameters `phi` are given instead of fitted, with the predictions of `take` linearised there.

    `phi` holds the logarithms of the base parameters, then the effects' parameters.  Log-likelihood and covariance are
    NaN and each segment's log-likelihood is 0, as they are not computed.
    """
    inputs = hypothesis.prediction_inputs(phi, take)
    r = pose_residuals(take, inputs, take.start)
    J = parameter_jacobian(take, hypothesis, phi, take.start, r, range(hypothesis.base_size))
    tangent = Tangent(linearise_nuisances(take, inputs, take.start).A, J)
    covariance = np.full((hypothesis.size, hypothesis.size), np.nan)
    return Fit(hypothesis, phi, take.start, scales, np.nan, np.zeros(take.segments), covariance, tangent)


def detectable_sizes(
    hypothesis: Hypothesis, phi: Floats, scales: Scales, take: Take, effects: Sequence[str]
) -> dict[str, Sizes | None]:
    """The smallest size at which each effect would be detected in `take`: value and unit of each strength parameter.

    Nothing is fitted: detection means that the expected log-likelihood gain reaches `required_gain_nats`.  For an
    effect at a place or time, the size is one that suffices at `min_share_of_places` of several typical ones.  None
    stands for an effect that is not detected up to its bounds.  `phi` holds the parameters of `hypothesis`, whose
    effects are left out.
    """
    fit = tangent_fit(hypothesis, phi, scales, take)
    names = [n for n in effects if n not in hypothesis.effects]
    amplitudes = amplitudes_at_typical_places(names, take, hypothesis)
    required = np.array([required_gain_nats(hypothesis.entries[a.effect], take.segments) for a in amplitudes])
    sizes = solve_smallest_sizes(fit, take, amplitudes, required) if amplitudes else []
    share, found = EXPERIMENT_LIMITS.min_share_of_places, dict[str, Sizes | None]()
    for name in names:
        seen: Sizes = {}
        for p in hypothesis.entries[name].amplitude_parameters:
            here = [s for a, s in zip(amplitudes, sizes, strict=True) if (a.effect, a.parameter) == (name, p)]
            if np.isfinite(here).mean() >= share:
                seen[p.symbol] = (float(np.sort(here)[int(share * (len(here) - 1))]), p.unit)
        found[name] = seen or None
    return found


def solve_smallest_sizes(fit: Fit, take: Take, amplitudes: list[PlacedAmplitude], required_nats: Floats) -> list[float]:
    """Solve for the size of each of K amplitudes at which the expected log-likelihood gain equals `required_nats` (K,).

    The size is multiplied by sqrt(required / expected gain) and simulated anew, with bisection as a safeguard.  The
    result is inf where the gain is not reached up to the amplitude's bound, or up to `max_size_multiple` times its
    given size.
    """
    sizes = np.array([a.values[a.parameter_index] for a in amplitudes])
    highest = np.minimum([a.parameter.high for a in amplitudes], EXPERIMENT_LIMITS.max_size_multiple * sizes)
    too_small, enough = np.zeros(len(amplitudes)), np.full(len(amplitudes), np.inf)
    open_ = np.arange(len(amplitudes))
    for _ in range(SIZE_ITERATIONS):
        now = sizes[open_]
        trials = [amplitudes[i].with_size(s) for i, s in zip(open_, now.tolist(), strict=True)]
        gains = expected_gains_nats(fit, take, trials)
        shows = gains >= required_nats[open_]
        too_small[open_] = np.where(shows, too_small[open_], now)
        enough[open_] = np.where(shows, now, enough[open_])
        step = np.sqrt(required_nats[open_] / np.maximum(gains, LIKELIHOOD_LIMITS.min_information))
        step = np.clip(step, 1.0 / MAX_SIZE_STEP, MAX_SIZE_STEP)
        low, high = too_small[open_], np.minimum(enough, highest)[open_]
        after = np.minimum(now * step, highest[open_])
        after = np.where((after > low) & (after < enough[open_]), after, np.sqrt(low * high))
        going = (np.abs(after / now - 1.0) >= SIZE_TOLERANCE) & (low < highest[open_])
        sizes[open_] = np.where(going, after, now)
        open_ = open_[going]
        if len(open_) == 0:
            break
    return [float(s) for s in np.where(np.isfinite(enough), sizes, np.inf)]


def expected_gains_nats(fit: Fit, take: Take, amplitudes: Sequence[PlacedAmplitude]) -> Floats:
    """Expected log-likelihood gains a^2 G / 2 (K,), in nats, of adding each of K effects of true amplitude a to a fit.

    G is the Fisher information about an amplitude, with the parameters of `fit` and each segment's initial state and
    disturbances projected out.
    """
    linearised = linearise_fit(fit, take)
    changes = compute_trial_changes(fit, take, [(a.effect, [a.values]) for a in amplitudes], linearised.r)
    return np.asarray(0.5 * project_out_fit(linearised, changes.columns).G[0])
