"""The base model fitted to a take from several starts, and the basins in which such fits end.

Far from the right car, large pushes explain any drive, and the likelihood hardly depends on the car any more.  So a fit
begins with pushes held small, when what the car does has to explain the poses as well as it can, and what it leaves
passes for noise.  From there, noise is held to what the poses' own roughness shows, or it would stay as large as that.
Each start is fitted so to a part of the take; the likeliest go on, and those that end best are fitted to all of it,
without limits.
"""

from collections.abc import Iterator, Sequence
from itertools import islice
from typing import NamedTuple

import numpy as np

from bcid.aliases import Floats
from bcid.likelihood.divergence import map_converged, none_if_diverged
from bcid.likelihood.hypothesis import Hypothesis
from bcid.likelihood.limits import LIKELIHOOD_LIMITS
from bcid.likelihood.refit import Fit, evaluate_fixed, refit
from bcid.likelihood.refit_state import Effort
from bcid.likelihood.scales import INDEPENDENT, UNLIMITED, Scales
from bcid.likelihood.take import Take
from bcid.physics.car import Car, typical_inertia_and_tyres

FIRST_PUSH = 0.05  # m/s^2 and rad/s^2: where the search for the pushes' scale begins, and what they are held below
PART_SEGMENTS = 40  # on which starts are compared: of 85 numbers each, for about 20 parameters
FIRST_NOISE = 2.0  # times the poses' own roughness, which noise is held below thereafter
FIRST_EFFORT = Effort(tangents=12)  # with pushes held small, and as many with noise held small
GO_ON = 2  # starts beside the nominal car's, with noise held small
BASINS = 2  # that are fitted to the whole take
SAME_BASIN_NATS = 10.0  # by which a fit's curvature parts two ends of one basin, short of where they would meet
FIRST_GRIPS = (2.0, 8.0)  # N/kg, of cars without a simulation beside the nominal one
FIRST_INERTIA = 1.3  # I_z of these cars over m l_f l_r
OTHER_MOTOR, OTHER_TYRES, OTHER_SERVO = 3.0, 4.0, 4.0  # factors between starts


class BaseFits(NamedTuple):
    """The likeliest fit of a base model, and those from other starts that ended in other basins, likeliest first."""

    best: Fit
    others: tuple[Fit, ...]


def fit_base(take: Take, hypothesis: Hypothesis, scales: Scales, assumed: Sequence[float] = ()) -> BaseFits:
    """The base model fitted to the take; effects that it always holds begin at `assumed` (SI).

    A fit from the nominal car that leaves all figures of a trusted simulation within `held_sd` of their trust stands
    alone.  Otherwise, and without a simulation, stiff and soft, quick and slow cars are starts, too (`first_cars`).
    The best fit is never less likely than the nominal car with the effects as assumed.

    Raises:
        PredictionDiverged: predictions diverge from every start.
    """
    base, nominal = hypothesis.with_effects(), hypothesis.nominal
    part = take.part(np.arange(0, take.segments, max(1, take.segments // PART_SEGMENTS)))
    # a part of a take says so much less against what a simulation is trusted for
    partly = base.scale_simulation_prior(part.segments / take.segments)
    starts = [(part, partly, base.phi_of(car, assumed), scales) for car in first_cars(hypothesis)]
    found = list(_fit_part(starts[:1]))
    if not (found and _holds_simulation(found[0])):
        found += _fit_part(starts[1:], required=not found)
    basins, start = _distinct(found), base.phi_of(nominal, assumed)
    ends = _ends_on(take, base, basins)
    ends.append((take, base, start, take.start, scales))  # should all that suits the part diverge elsewhere
    fits = list(islice(map_converged(refit, ends, required=True), min(BASINS, len(basins))))
    fits += _not_below_start(_distinct(fits)[0], take, start)
    best, *others = _distinct(fits)
    return BaseFits(best, tuple(others))


def refit_basins(take: Take, fits: BaseFits) -> BaseFits:
    """The fits refitted to a take that is cut otherwise, or predicted in finer steps, from where they ended.

    Raises:
        PredictionDiverged: predictions diverge from every end.
    """
    ends = _ends_on(take, fits.best.hypothesis, (fits.best, *fits.others))
    best, *others = _distinct(list(map_converged(refit, ends, required=True)))
    return BaseFits(best, tuple(others))


def _ends_on(
    take: Take, hypothesis: Hypothesis, fits: Sequence[Fit]
) -> list[tuple[Take, Hypothesis, Floats, Floats, Scales]]:
    """Arguments of refits of a hypothesis to a take from where `fits` to a part of it, or another cut, have ended."""
    return [(take, hypothesis, f.phi, take.start, f.scales) for f in fits]


def first_cars(hypothesis: Hypothesis) -> list[Car]:
    """Cars from which a base model is fitted: the nominal one, and others like it of soft and stiff tyres.

    Of soft ones with a stronger motor, of stiff ones with a weaker motor; of soft ones with a slower servo, of stiff
    ones with a quicker one, where the vehicle file does not say how quick it is.  Without a simulation tyres are
    typical ones of little and of much grip, as the nominal ones are a mere guess.
    """
    nominal, unknown = hypothesis.nominal, hypothesis.unknown_steering
    stiff = nominal._replace(C_f=nominal.C_f * OTHER_TYRES, C_r=nominal.C_r * OTHER_TYRES)
    soft = nominal._replace(
        C_f=nominal.C_f / OTHER_TYRES, C_r=nominal.C_r / OTHER_TYRES, F_f_max=2.0 * nominal.F_f_max,
        F_r_max=2.0 * nominal.F_r_max,
    )  # fmt: skip
    if hypothesis.trusted_simulation is None:
        size = (nominal.m, nominal.l_f, nominal.l_r, FIRST_INERTIA)
        soft, stiff = (nominal._replace(**typical_inertia_and_tyres(*size, g, g)) for g in FIRST_GRIPS)
    weak, strong = stiff._replace(K_t=nominal.K_t / OTHER_MOTOR), soft._replace(K_t=nominal.K_t * OTHER_MOTOR)
    cars = [nominal, soft, stiff, weak, strong]
    if "T_s" in unknown:
        cars += [stiff._replace(T_s=nominal.T_s / OTHER_SERVO), soft._replace(T_s=nominal.T_s * OTHER_SERVO)]
    if "d" in unknown:  # a servo may have no limit that shows
        cars[1:] = [car._replace(d=max(car.d, 2.0 * hypothesis.angle_limit / car.T_s)) for car in cars[1:]]
    return cars


def _fit_part(starts: Sequence[tuple[Take, Hypothesis, Floats, Scales]], required: bool = False) -> list[Fit]:
    """Fits of a part of a take from `starts` (part, base model, phi, scales), with pushes held small, then with noise.

    The likeliest GO_ON with pushes held small, in different basins, go on.

    Raises:
        PredictionDiverged: all diverge, and one is `required`.
    """
    first = list(map_converged(_fit_with_small_pushes, starts, required=required))
    on = [(starts[0][0], f.hypothesis, f.phi, f.start, starts[0][3]) for f in _distinct(first)[:GO_ON]]
    return list(map_converged(_fit_with_small_noise, on, required=required))


def _fit_with_small_pushes(part: Take, base: Hypothesis, phi: Floats, scales: Scales) -> Fit:
    """The base model fitted from phi: what the car does has to explain the poses."""
    by_noise = UNLIMITED._replace(q=np.full(3, FIRST_PUSH), rho=INDEPENDENT)  # lasting ones could do more
    return refit(part, base, phi, part.start, scales, FIRST_EFFORT, most=by_noise)


def _fit_with_small_noise(part: Take, base: Hypothesis, phi: Floats, start: Floats, scales: Scales) -> Fit:
    """The base model fitted from phi: what it leaves passes for pushes."""
    by_pushes = UNLIMITED._replace(r=FIRST_NOISE * scales.r)
    return refit(part, base, phi, start, scales, FIRST_EFFORT, most=by_pushes)


def _holds_simulation(fit: Fit) -> bool:
    """Whether a fit leaves each figure of a trusted simulation as near as it is known to be."""
    if fit.hypothesis.trusted_simulation is None:
        return False
    off = fit.hypothesis.prior(fit.phi).deviations(fit.phi)
    return bool(np.max(np.abs(off)) < LIKELIHOOD_LIMITS.held_sd)


def _distinct(fits: Sequence[Fit]) -> list[Fit]:
    """The fits, likeliest first, less those that ended in the basin of a likelier one."""
    found = list[Fit]()
    for fit in sorted(fits, key=lambda f: -f.penalised_log_likelihood):
        if not any(_are_in_one_basin(fit, other) for other in found):
            found.append(fit)
    return found


def _are_in_one_basin(fit: Fit, other: Fit) -> bool:
    """Whether the curvature at the `other` fit bridges what the parameters differ by."""
    off = fit.phi - other.phi
    return float(0.5 * off @ np.linalg.pinv(other.covariance) @ off) < SAME_BASIN_NATS


def _not_below_start(fit: Fit, take: Take, phi: Floats) -> Iterator[Fit]:
    """A refit from the parameters phi where these are likelier than the `fit` once their initial states have settled.

    What fits a part may be less likely on the whole than where it began.
    """
    settled = none_if_diverged(evaluate_fixed, take, fit.hypothesis, phi, fit.scales)
    if settled is not None and settled.penalised_log_likelihood > fit.penalised_log_likelihood:
        yield from map_converged(refit, [(take, fit.hypothesis, phi, settled.start, settled.scales)])
