"""The last step to where an effect is: an edge on the floor gives the likelihood kinks that a slope cannot follow."""

from __future__ import annotations

import itertools

import numpy as np
from scipy.optimize import Bounds, direct

from bcid.aliases import Floats
from bcid.likelihood.marginal import eliminate, log_likelihood, moments
from bcid.likelihood.nuisance import deviations
from bcid.likelihood.refit import Fit, refit
from bcid.likelihood.take import Take

WIDEST, FINEST = 0.6, 0.02  # of the radius (of a tenth of the take, for a time)
LEAST = 0.3  # m, for the bumper car
BETTER = 0.1  # nats from which a step is taken,
WORTH = 1.0  # and a walk
WALKS = 4
LOOKS = 1000  # of a search all around before a walk


def placed(fit: Fit, take: Take) -> Fit:
    """The fit with its effects' places and times where the likelihood is highest nearby."""
    if not fit.hypothesis.placed.any():
        return fit
    for _ in range(WALKS):
        try:
            better = refit(take, fit.hypothesis, _walked(fit, take), fit.start, fit.scales)
        except FloatingPointError:  # beside an edge the car may spin out of the numbers: the place found before stands
            return fit
        if better.bic - fit.bic < WORTH:
            return fit
        fit = better
    return fit


def _walked(fit: Fit, take: Take) -> Floats:
    """Phi after a search over one effect's places after another, all else as it is."""
    phi = fit.phi
    for name in fit.hypothesis.effects:
        widths = _widths(fit, take, name)
        if widths.any():
            phi = _walked_over(fit, take, phi, widths)
    return phi


def _widths(fit: Fit, take: Take, name: str) -> Floats:
    """By how much each component of phi moves in a step of one: the effect's places and times, and nothing else."""
    values, widths = fit.values(), np.zeros(fit.hypothesis.size)
    for i, (field, p) in enumerate(fit.hypothesis.parameters, start=fit.hypothesis.base_size):
        if p.places and field.startswith(f"{name}__"):
            reach = [v for f, (v, _) in values.items() if f in (f"{name}__radius", f"{name}__r_0")]
            widths[i] = (
                0.1 * float(take.length_s.max())
                if p.symbol == "t_s"
                else max(*reach, LEAST * fit.hypothesis.units.reach)
            )
    return widths


def _walked_over(fit: Fit, take: Take, phi: Floats, widths: Floats) -> Floats:
    """Phi where the likelihood is highest within `widths`.

    A circle that moves and grows at once climbs a ridge too narrow for a walk: another starts from the best of
    rectangles divided all around (DIRECT, Jones and others, 1993).
    """
    low, high = fit.hypothesis.bounds()
    moving = np.flatnonzero(widths)
    around = Bounds(np.maximum(phi - widths, low)[moving], np.minimum(phi + widths, high)[moving])

    def at(place: Floats) -> Floats:
        there = phi.copy()
        there[moving] = place
        return there

    def against(place: Floats) -> float:
        return -_likelihood(fit, take, at(place))

    found = at(direct(against, around, maxfun=LOOKS).x)
    return max((_walk(fit, take, start, widths) for start in (phi, found)), key=lambda end: _likelihood(fit, take, end))


def _walk(fit: Fit, take: Take, phi: Floats, widths: Floats) -> Floats:
    """Phi after a pattern search."""
    moves = np.array(list(itertools.product((-1.0, 0.0, 1.0), repeat=int(np.count_nonzero(widths)))))
    steps = np.zeros((len(moves), len(phi)))
    steps[:, widths > 0.0] = moves * widths[widths > 0.0]
    best, share = _likelihood(fit, take, phi), WIDEST
    while share > FINEST:
        near = [np.clip(phi + share * step, *fit.hypothesis.bounds()) for step in steps]
        likelihoods = [_likelihood(fit, take, there) for there in near]
        k = int(np.argmax(likelihoods))
        if likelihoods[k] > best + BETTER:
            best, phi = likelihoods[k], near[k]
        else:
            share *= 0.5
    return phi


def _likelihood(fit: Fit, take: Take, phi: Floats) -> float:
    """Of phi, with the fit's initial states, scales and tangent."""
    r = deviations(take, fit.hypothesis.setting(phi, take), fit.start, fit.tangent.A)
    if not np.isfinite(r).all():
        return -np.inf
    of = moments(r, fit.tangent.A, take.first)
    likelihood = float(log_likelihood(eliminate(of, fit.scales.r, fit.scales.precisions())).sum())
    return likelihood if np.isfinite(likelihood) else -np.inf
