"""What has no name beside a car that is held: functions of the car's own state, for predictions.

A remainder that is refitted with the names makes a take likeliest, but takes the names where no car is, as functions
make up for that on this drive.  For predictions the car comes first, as it is fitted without functions, and what it
leaves is explained beside it (a *modular* fit: Liu, Bayarri and Berger 2009).  Functions of the place and of the time
are left out, as another drive is elsewhere and later.
"""

from dataclasses import replace

import numpy as np
from threadpoolctl import threadpool_limits

from bcid.diagnosis.remainder.explain import driven_quantities, explain_with_copies
from bcid.diagnosis.remainder.fit import RemainderFit, fit_with_remainder
from bcid.diagnosis.remainder.functions import LEAST_HALF_WIDTH, middle_range, remainder_basis
from bcid.effects.corrections import RAW_COMMANDS
from bcid.effects.remainder_table import INPUTS, OF_THE_CAR
from bcid.likelihood.divergence import none_if_diverged
from bcid.likelihood.refit import Fit, evaluate_fixed
from bcid.likelihood.take import Take
from bcid.models.newton_euler.unnamed_part import UnnamedPart

HELD_SD = 1e-3
"""How well, as a share, the car and its effects count as known: they stay where they are."""

PARTS = 15
"""Into so many parts each segment of 1.5 s is cut for the ranges of a drive: 0.1 s, a usual period of models."""


def unnamed_part_beside(fit: Fit, take: Take) -> UnnamedPart | None:
    """The functions of the car's state that make a `take` likelier beside the car and effects of `fit`, as they are.

    None where there are no such functions, or the take cannot be followed.
    """
    with threadpool_limits(1, "blas"):
        return none_if_diverged(_find_unnamed_part, fit, take)


def _find_unnamed_part(fit: Fit, take: Take) -> UnnamedPart | None:
    """What `unnamed_part_beside` returns, where nothing diverges."""
    found = fit_beside_held_names(fit, take)
    if not len(found.on):
        return None
    functions, quantities = found.fit.hypothesis.functions(found.fit.phi), driven_quantities(fit, take, PARTS)
    ranges = [_widen_range(middle_range(quantities[name])) for name in INPUTS[:OF_THE_CAR]]
    return UnnamedPart(functions.on_body, found.basis.half_waves, np.array(ranges))


def fit_beside_held_names(fit: Fit, take: Take) -> RemainderFit:
    """The fit with its names held, and functions of the car's own state beside them."""
    h, car = fit.hypothesis, fit.car()
    values = list(h.effect_values(fit.phi).values())
    names = replace(h, assumed=h.effects, nominal=car)
    held = names.trust_simulation(values, HELD_SD, dict.fromkeys(RAW_COMMANDS, HELD_SD))
    assert held.trusted_simulation is not None  # noqa: S101  # it has just been given
    # a normal law: one of heavy tails lets go of what is pulled hard
    held = replace(held, trusted_simulation=held.trusted_simulation._replace(nu=np.inf))
    start = evaluate_fixed(take, held, held.phi_of(car, values), fit.scales)
    basis = remainder_basis(driven_quantities(fit, take), car).of_the_car()
    return fit_with_remainder(start, take, explain_with_copies(start, take, basis, ()))


def _widen_range(limits: tuple[float, float]) -> tuple[float, float]:
    """The range with these limits, or one of LEAST_HALF_WIDTH about its centre if it is narrower."""
    centre, half = 0.5 * sum(limits), max(0.5 * (limits[1] - limits[0]), LEAST_HALF_WIDTH)
    return centre - half, centre + half
