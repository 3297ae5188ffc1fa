"""What a remainder explains beside a fit, to first order: smooth functions, and the waves that are needed.

Nothing is refitted: coefficients and their spreads follow from the fit's residual and derivatives.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from bcid.aliases import Floats
from bcid.diagnosis.kept_steps import kept_under
from bcid.diagnosis.limits import LOCATE_LIMITS, SEARCH_LIMITS
from bcid.diagnosis.locate.pushes import mean_states
from bcid.diagnosis.remainder.evidence import Quadratic, channel_worths, likeliest_spreads
from bcid.diagnosis.remainder.functions import CHANNELS, RemainderBasis, channel_of, remainder_basis
from bcid.diagnosis.remainder.information import TakeInformation, gather_information
from bcid.diagnosis.remainder.waves import MOST_WAVES, add_waves, find_wave
from bcid.likelihood.marginal import robust_weights
from bcid.likelihood.refit import Fit
from bcid.likelihood.take import KNOTS, SEGMENT_S, Take

REWEIGHTINGS = 3  # of segments, while the remainder is found from nothing


class Explained(NamedTuple):
    """What a remainder explains beside a fit, to first order."""

    effects: tuple[str, ...]  # that the fit holds
    basis: RemainderBasis
    spread: Mapping[str, float]
    quadratic: Quadratic
    c: Floats  # (K,)
    moved: Floats  # (n,) the change of the fit's own parameters that is likeliest beside it
    weights: Floats  # (S,) of segments

    @classmethod
    def of_nothing(cls, fit: Fit, at: TakeInformation, basis: RemainderBasis) -> Explained:
        """Nothing explained yet beside a fit."""
        none, K = dict.fromkeys(basis.channels, 0.0), len(basis.size)
        nothing = Quadratic(np.zeros(K), np.zeros((K, K)))
        effects = fit.hypothesis.effects
        return cls(effects, basis, none, nothing, np.zeros(K), np.zeros_like(at.phi), at.robust_weights)

    def beside(self, basis: RemainderBasis) -> Explained:
        """What is explained, with the functions of a larger basis, of which nothing is known yet."""
        return self._replace(basis=basis, spread=dict.fromkeys(basis.channels, 0.0) | dict(self.spread))

    @property
    def nats(self) -> float:
        """What the remainder adds, by evidence."""
        return self.quadratic.log_evidence(self.basis.sd(self.spread)) - self.basis.price(self.spread)

    def channel_nats(self) -> dict[str, float]:
        """Nats that the functions of each channel add beside those of the others, most first."""
        return channel_worths(self.quadratic, self.basis, self.spread)

    def depends_on(self, channel: str) -> tuple[str, ...]:
        """The quantities, most important first, on which what the functions of a `channel` explain depends.

        Of what varies each must explain a share; none where a constant explains nearly all.
        """
        nats, quantities = 0.5 * self.c * self.quadratic.b, self.basis.quantities()
        own = np.array([channel_of(name) == channel for name in self.basis.channel])
        shares = {q: float(nats[own & on].sum()) for q, on in quantities.items()}
        varying = float(nats[own & np.any(list(quantities.values()), axis=0)].sum())
        if varying < LOCATE_LIMITS.min_quantity_share * float(nats[own].sum()):
            return ()
        least = LOCATE_LIMITS.min_quantity_share * varying
        first = sorted((q for q, n in shares.items() if n > max(least, 0.0)), key=lambda q: -shares[q])
        return tuple(first[: LOCATE_LIMITS.max_quantities])


@kept_under()
def basis_for(fit: Fit, take: Take) -> RemainderBasis:
    """The functions of a remainder over what the take's drive went through, by the states that `fit` predicts."""
    return remainder_basis(driven_quantities(fit, take), fit.car())


def driven_quantities(fit: Fit, take: Take, parts: int = KNOTS) -> dict[str, Floats]:
    """What the take's drive went through (n,), by the names in INPUTS: means over `parts` parts of its segments."""
    q, car = mean_states(fit, take, parts), fit.car()
    across = q["v_y"] + car.l_f * q["omega"]
    v_fx = np.cos(q["delta"]) * q["v_x"] + np.sin(q["delta"]) * across
    within_s = (np.arange(parts) + 0.5) * SEGMENT_S / parts
    time_s = (take.begin_s - take.zero_s)[:, None] + within_s
    return {**q, "v_fx": v_fx, "t": time_s.ravel()}


@kept_under("remainder_error", "min_wave_nats")
def explain(fit: Fit, take: Take, basis: RemainderBasis) -> Explained:
    """What a remainder explains beside a `fit`, to first order: smooth functions, and the waves that are needed.

    Segments that the remainder explains gain weight, as in the likelihood.
    """
    at = gather_information(fit, take, basis, np.zeros(len(basis.size)))
    seen = _reweigh(at, Explained.of_nothing(fit, at, basis), (), REWEIGHTINGS)
    for _ in range(MOST_WAVES):
        moved = at.weigh(seen.weights).names_beside(seen.c)
        # what gains less than smooth functions err by is not worth its refits
        least = SEARCH_LIMITS.remainder_error * seen.nats
        wave = find_wave(at, fit.car(), seen.weights, moved, seen.c, least)
        if wave is None:
            break
        before, basis = basis, add_waves(basis, [wave])
        if len(basis.tracking) == len(before.tracking):
            at = at.with_functions(basis, fit.car())
        else:
            at = gather_information(fit, take, basis, np.zeros(len(basis.size)))
        seen = _reweigh(at, seen.beside(basis), (), 1)
    return seen


def explained_elsewhere(fit: Fit, elsewhere: TakeInformation, basis: RemainderBasis) -> float:
    """Nats that the functions of a `basis` explain in `elsewhere`, which holds them as other segments have them."""
    return _reweigh(elsewhere, Explained.of_nothing(fit, elsewhere, basis), (), REWEIGHTINGS).nats


def explain_with_copies(fit: Fit, take: Take, basis: RemainderBasis, copied: tuple[str, ...] = CHANNELS) -> Explained:
    """What a remainder explains beside the `fit` where copies of laws that have names help, in the channels `copied`.

    It has the functions of the `basis`, and no more waves than these.
    """
    at = gather_information(fit, take, basis, np.zeros(len(basis.size)))
    return _reweigh(at, Explained.of_nothing(fit, at, basis), copied, REWEIGHTINGS)


def _reweigh(at: TakeInformation, seen: Explained, copied: tuple[str, ...], times: int) -> Explained:
    """What a remainder explains, its spreads found and segments weighed anew so many `times`."""
    basis, weights, spread = seen.basis, seen.weights, seen.spread
    for _ in range(times):
        weighed = at.weigh(weights)
        quadratic = weighed.quadratic
        spread = likeliest_spreads(quadratic, basis, basis.groups(copied), spread)
        c = quadratic.posterior_mean(basis.sd(spread))
        moved = weighed.names_beside(c)
        weights = robust_weights(at.terms._replace(chi2=at.chi2_beside(moved, c)))
    return Explained(seen.effects, basis, spread, quadratic, c, moved, weights)
