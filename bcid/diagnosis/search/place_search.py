"""The search for the place or time of an effect: an edge on the floor gives the likelihood kinks without a slope."""

import itertools

import numpy as np
from scipy.optimize import Bounds, direct

from bcid.aliases import Floats, Ints
from bcid.likelihood.divergence import none_if_diverged
from bcid.likelihood.kept_fits import kept_in_proofs
from bcid.likelihood.marginal import eliminate_nuisance, segment_moments, student_log_densities
from bcid.likelihood.nuisance import pose_residuals
from bcid.likelihood.refit import Fit, refit
from bcid.likelihood.score_test import affected_segments
from bcid.likelihood.take import SEGMENT_S, Take

# steps, as shares of the radius, or of a tenth of the take for a time
WIDEST_STEP, FINEST_STEP = 0.6, 0.02

# least radius that steps are shares of, of a vehicle as large and as fast as the bumper car
MIN_REACH_M = 0.3

# gains from which a step is taken, and a round of searches is followed by another
MIN_STEP_NATS, MIN_ROUND_NATS, MAX_ROUNDS = 0.1, 1.0, 4

DIRECT_EVALUATIONS = 1000


@kept_in_proofs
def refine_places(fit: Fit, take: Take) -> Fit:
    """The refit with the places and times of its effects moved to where the likelihood is highest nearby.

    The search reaches as far as a place's own radius, or a tenth of the take's length for a time.  At most MAX_ROUNDS
    rounds of search and refit are made; a round that gains less than 1 nat of penalised log-likelihood is the last,
    and is discarded.
    """
    if not fit.hypothesis.is_place.any():
        return fit
    for _ in range(MAX_ROUNDS):
        phi = fit.phi
        for name in fit.hypothesis.effects:
            widths = _search_widths(fit, take, name)
            chosen = segments_in_reach(fit, take, name, phi, widths)
            if widths.any() and len(chosen):
                phi = _search_around(*fit.part(take, chosen), phi, widths)
        # at the edge of a place the prediction may diverge: then the fit stays as it is
        better = none_if_diverged(refit, take, fit.hypothesis, phi, fit.start, fit.scales)
        if better is None or better.penalised_log_likelihood - fit.penalised_log_likelihood < MIN_ROUND_NATS:
            return fit
        fit = better
    return fit


def _search_widths(fit: Fit, take: Take, name: str) -> Floats:
    """Half-widths (n,) of a search around the parameter vector phi that moves only the place or time of effect `name`.

    They are the place's radius (m; at least MIN_REACH_M, scaled to the vehicle), or a tenth of the take's length (s)
    for a time, and 0 for all other components of phi (base parameters, then effects' parameters).
    """
    values, widths = fit.effect_estimates(), np.zeros(fit.hypothesis.size)
    for i, (field, p) in enumerate(fit.hypothesis.effect_parameters, start=fit.hypothesis.base_size):
        if p.is_place and field.startswith(f"{name}__"):
            radii = [v for f, (v, _) in values.items() if f in (f"{name}__radius", f"{name}__r_0")]
            least = MIN_REACH_M * fit.hypothesis.units.circle_factor
            widths[i] = 0.1 * float(take.length_s.max()) if p.symbol == "t_s" else max(*radii, least)
    return widths


def segments_in_reach(fit: Fit, take: Take, name: str, phi: Floats, widths: Floats) -> Ints:
    """The segments in which the effect `name` is not the same everywhere within `widths` around `phi`.

    They are those that meet any circle of the search, or the time at which anything may change in it.
    """
    values = fit.hypothesis.effect_values(phi)
    reach = zip(values.items(), widths[fit.hypothesis.base_size : fit.hypothesis.named_size], strict=True)
    own = {f.partition("__")[2]: (v, w) for (f, v), w in reach if f.startswith(f"{name}__")}
    at, width = {symbol: v for symbol, (v, _) in own.items()}, max(w for _, w in own.values())
    if "radius" in at:
        at["radius"] += (1.0 + np.sqrt(2.0)) * width  # it grows, and its centre moves along x and y
    if "t_s" not in at:
        path = take.pose - pose_residuals(take, fit.hypothesis.prediction_inputs(phi, take), fit.start)
        return affected_segments(take, path, at)
    later = take.begin_s - take.zero_s - SEGMENT_S > at["t_s"] + width
    at["t_s"] -= width
    return np.setdiff1d(affected_segments(take, take.pose, at), np.flatnonzero(later))


def _search_around(fit: Fit, take: Take, phi: Floats, widths: Floats) -> Floats:
    """Parameter vector phi of highest likelihood found within the half-widths `widths` (n,) around `phi` (n,).

    Components of half-width 0 stay.  Two pattern searches are made, from `phi` and from the best point of a global
    search (DIRECT, Jones and others, 1993), and the better result is taken: where a circle moves and grows at once the
    likelihood has a narrow ridge, on which one local search may stop short.
    """
    low, high = fit.hypothesis.bounds()
    moving = np.flatnonzero(widths)
    around = Bounds(np.maximum(phi - widths, low)[moving], np.minimum(phi + widths, high)[moving])

    def with_place(place: Floats) -> Floats:
        """Phi with its components that move at `place`."""
        there = phi.copy()
        there[moving] = place
        return there

    def misfit(place: Floats) -> float:
        """Negative log-likelihood at `place`."""
        return -_log_likelihood_at(fit, take, with_place(place))

    found = with_place(direct(misfit, around, maxfun=DIRECT_EVALUATIONS).x)
    return max(
        (_search_pattern(fit, take, start, widths) for start in (phi, found)),
        key=lambda end: _log_likelihood_at(fit, take, end),
    )


def _search_pattern(fit: Fit, take: Take, phi: Floats, widths: Floats) -> Floats:
    """Parameter vector phi (n,) of highest likelihood found by a pattern search that starts from `phi` (n,).

    Neighbours are all combinations of steps -1, 0 and 1 times a share of the half-width in `widths` (n,) of each
    component, clipped to bounds.  The search moves to the best if it gains MIN_STEP_NATS; otherwise the share is
    halved, from WIDEST_STEP down to FINEST_STEP.
    """
    moves = np.array(list(itertools.product((-1.0, 0.0, 1.0), repeat=int(np.count_nonzero(widths)))))
    steps = np.zeros((len(moves), len(phi)))
    steps[:, widths > 0.0] = moves * widths[widths > 0.0]
    best, share = _log_likelihood_at(fit, take, phi), WIDEST_STEP
    while share > FINEST_STEP:
        near = [np.clip(phi + share * step, *fit.hypothesis.bounds()) for step in steps]
        likelihoods = [_log_likelihood_at(fit, take, there) for there in near]
        k = int(np.argmax(likelihoods))
        if likelihoods[k] > best + MIN_STEP_NATS:
            best, phi = likelihoods[k], near[k]
        else:
            share *= 0.5
    return phi


def _log_likelihood_at(fit: Fit, take: Take, phi: Floats) -> float:
    """Marginal log-likelihood (nats) of the take at parameter vector `phi` (n,); -inf where predictions diverge.

    All else is as in `fit`: initial states, standard deviations of noise and disturbances, and the derivatives of
    predictions by initial states and disturbances, by which these are integrated out.
    """
    r = fit.residuals(take, phi)
    if not np.isfinite(r).all():
        return -np.inf
    moments = segment_moments(r, fit.tangent.A, take.first)
    eliminated = eliminate_nuisance(moments, fit.scales.r, fit.scales.nuisance_precision())
    likelihood = float(student_log_densities(eliminated).sum())
    return likelihood if np.isfinite(likelihood) else -np.inf
