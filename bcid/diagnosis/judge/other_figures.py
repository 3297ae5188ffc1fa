"""Figures of a trusted simulation that are others in the car of a take: needed where the published one does not hold.

A figure is told if a take needs it outside of what its trust gives for likely, and if the published one would make the
take less likely by more than chance reaches.
"""

from typing import NamedTuple

import numpy as np
from scipy.special import stdtrit

from bcid.aliases import Floats
from bcid.diagnosis.limits import JUDGE_LIMITS
from bcid.likelihood.hypothesis import DRAG, Hypothesis
from bcid.likelihood.prior import TRUST_NU
from bcid.likelihood.refit import Fit
from bcid.models.newton_euler.parameters import constant_units


class ChangedFigure(NamedTuple):
    """A figure of the simulation that is another one in the take, in SI units."""

    symbol: str  # of the base model, or `effect__symbol`
    published: float
    needed: float
    se: float
    unit: str
    nats: float  # by which the published figure, all others free, makes the take less likely


def find_other_figures(fit: Fit, beside: Fit, gate: float) -> tuple[ChangedFigure, ...]:
    """The figures of the simulation of a `fit` that are others in its take, the most certain first.

    They must be so without a remainder, and in the fit `beside` one: where much has no name, figures are bent to do
    some of it.  Told is what fewer nats speak for.
    """
    alone, too = ({f.symbol: f for f in _figures_outside_trust(of, gate)} for of in (fit, beside))
    found = [min(alone[s], too[s], key=lambda f: f.nats) for s in alone.keys() & too.keys()]
    return tuple(sorted(found, key=lambda f: -f.nats))


def _figures_outside_trust(fit: Fit, gate: float) -> list[ChangedFigure]:
    """The figures of the simulation of a `fit` that are others by this fit alone.

    A figure is another if the simulation's trust says with `figure_p_value` that it lies as far off, and if the take
    tells so by more than the `gate` (nats).  These follow from the fit's curvature: half the square of the standard
    errors between the two figures.  A figure at a bound of what any car has is none that a take needs: something else
    is missing there.  Empty without a trusted simulation.
    """
    hypothesis, trusted = fit.hypothesis, fit.hypothesis.trusted_simulation
    if trusted is None:
        return []
    n, published = len(trusted.phi), hypothesis.with_effects()
    off = hypothesis.prior(fit.phi).deviations(fit.phi)[:n]
    far = -float(stdtrit(TRUST_NU, 0.5 * JUDGE_LIMITS.figure_p_value))
    sd = np.sqrt(np.maximum(np.diag(fit.covariance)[:n], 0.0))
    se, units = np.abs(hypothesis.units_at(fit.phi)[:n]) * sd, _units_of_figures(published)
    before, after = _figures(published, np.array(trusted.phi)), _figures(hypothesis, fit.phi)
    found = list[ChangedFigure]()
    for j in np.flatnonzero((np.abs(off) > far) & ~hypothesis.is_at_bound(fit.phi)[:n] & (sd > 0.0)):
        nats = 0.5 * float((fit.phi[j] - trusted.phi[j]) / sd[j]) ** 2
        if nats > gate:
            symbol = list(before)[j]
            found.append(ChangedFigure(symbol, before[symbol], after[symbol], float(se[j]), units[symbol], nats))
    return found


def _figures(hypothesis: Hypothesis, phi: Floats) -> dict[str, float]:
    """Values (SI) of base and effects' parameters by symbol, in the order of phi."""
    car = hypothesis.car(phi)
    return {s: getattr(car, s) for s in (*hypothesis.log_parameters, *DRAG)} | hypothesis.effect_values(phi)


def _units_of_figures(hypothesis: Hypothesis) -> dict[str, str]:
    """SI units of base and effects' parameters by symbol."""
    return constant_units(hypothesis.nominal) | {field: p.unit for field, p in hypothesis.effect_parameters}
