"""The fit of the base model that everything else is compared with."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bcid.likelihood.hypothesis import Hypothesis
from bcid.likelihood.marginal import Scales
from bcid.likelihood.refit import Fit, refit
from bcid.likelihood.take import Take
from bcid.physics.car import with_usual_tyres

GRIPS = (2.0, 8.0)  # N/kg
ENOUGH = 100  # segments on which starts are compared
LOST = 5.0  # nats per segment: a refit to the whole that is worth so much less than that of the part (94 were seen)


def base_fit(take: Take, hypothesis: Hypothesis, scales: Scales, assumed: Sequence[float] = ()) -> Fit:
    """The base model refitted to the take, with what it assumes from the values `assumed`.

    From the nominal car, which may be far off where it comes from one-step predictions, and from cars with usual
    tyres that slide or do not: grip that is never reached has no slope.  The best of them on a part of the take is
    refitted to the whole; where that leads astray, from other scales and from the next best, and the best of them is
    taken where all do.  Of a take so short that the part is all of it either fit will do: the better one, or the one
    that there is.  A trusted simulation is its own only start.

    Raises:
        FloatingPointError: when none stays within the finite numbers.
    """
    base, nominal = hypothesis.holding(), hypothesis.nominal
    chosen = np.arange(0, take.segments, max(1, take.segments // ENOUGH))
    part, fits, error = take.part(chosen), list[Fit](), FloatingPointError()
    usual = [with_usual_tyres(nominal, grip) for grip in GRIPS]
    if "d" in hypothesis.unknown_steering:  # a servo may have no limit that shows
        usual = [car._replace(d=max(car.d, 2.0 * hypothesis.angle_limit / car.T_s)) for car in usual]
    for car in (nominal, *usual) if hypothesis.simulated is None else (nominal,):
        try:
            fits.append(refit(part, base, base.start(car, assumed), part.start, scales))
        except FloatingPointError as failed:
            error = failed
    astray, short = list[Fit](), part.segments == take.segments
    for fit in sorted(fits, key=lambda f: -f.bic):
        for begun in (fit.scales, scales):
            try:
                whole = refit(take, base, fit.phi, take.start, begun)
            except FloatingPointError as failed:
                error = failed
                continue
            if short:
                return max(fit, whole, key=lambda f: f.bic)
            if whole.per_segment.mean() > fit.per_segment.mean() - LOST:
                return whole
            astray.append(whole)
        if short:
            return fit
    if astray:
        return max(astray, key=lambda f: f.bic)
    raise error
