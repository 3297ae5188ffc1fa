"""The parameters of a diagnosis's base model as they are written: those of its fit, and what the take alone shows."""

import math

import numpy as np

from bcid.aliases import Floats
from bcid.diagnosis.limits import SUMMARY_LIMITS
from bcid.documents import diagnosis as written
from bcid.effects.table import effect_ids
from bcid.likelihood.hypothesis import DRAG
from bcid.likelihood.refit import Fit
from bcid.likelihood.without_prior import LEAST_INFORMATION, take_away_prior
from bcid.models.newton_euler.parameters import constant_units


def describe_base_parameters(fit: Fit) -> list[written.BaseParameter]:
    """The refitted parameters of the base model, and of the effects that it assumes, with standard errors.

    `shown` is false for base parameters with a relative standard error of `SUMMARY_LIMITS.max_relative_se` or more,
    except drag R_1 and R_2; `at_bound` is true for parameters that ended at a bound.  Beside a simulation
    `of_recording` is what the recording alone shows, if its error is below the same share.
    """
    car, hypothesis, values = fit.car(), fit.hypothesis, fit.effect_estimates()
    se = np.sqrt(np.maximum(np.diag(fit.covariance), 0.0))
    units, scales = constant_units(car), hypothesis.units_at(fit.phi)
    stuck = hypothesis.is_at_bound(fit.phi).tolist()
    alone = _describe_take_alone(fit) if hypothesis.trusted_simulation is not None else {}
    own = [
        written.BaseParameter(
            symbol=s, value=getattr(car, s), se=float(abs(scale) * e), unit=units[s],
            shown=bool(e < SUMMARY_LIMITS.max_relative_se or s in DRAG), at_bound=at_end, of_recording=alone.get(s),
        )
        for s, scale, e, at_end in zip((*hypothesis.log_parameters, *DRAG), scales, se, stuck, strict=False)
    ]  # fmt: skip
    return own + [
        written.BaseParameter(
            symbol=field.replace("__", "."), value=values[field][0], se=values[field][1], unit=p.unit, at_bound=at_end
        )
        for (field, p), at_end in zip(hypothesis.effect_parameters, stuck[hypothesis.base_size :], strict=True)
        if effect_ids([field])[0] in hypothesis.assumed
    ]


def _describe_take_alone(fit: Fit) -> dict[str, written.Quantity]:
    """The base parameters as the take alone shows them, by symbol, of those that it shows and that are at no bound."""
    car, hypothesis = fit.car(), fit.hypothesis
    units, found = constant_units(car), dict[str, written.Quantity]()
    changes, errors = (vector.tolist() for vector in without_trust(fit))
    scales, stuck = hypothesis.units_at(fit.phi).tolist(), hypothesis.is_at_bound(fit.phi).tolist()
    for s, change, error, scale, at_end in zip(
        (*hypothesis.log_parameters, *DRAG), changes, errors, scales, stuck, strict=False
    ):
        if at_end or (s not in DRAG and error >= SUMMARY_LIMITS.max_relative_se):
            continue
        # all but drag are logarithms
        value = getattr(car, s) + scale * change if s in DRAG else getattr(car, s) * math.exp(change)
        size = abs(scale if s in DRAG else value)
        found[s] = written.Quantity(value=value, se=size * error, unit=units[s])
    return found


def without_trust(fit: Fit) -> tuple[Floats, Floats]:
    """By how much phi (n,) of a fit is another by its take alone, and with which standard errors (n,).

    At a fit the slopes of likelihood and prior cancel: the likelihood alone, of the curvature that is left without the
    prior's, is greatest where its slope, the prior's with the other sign, leads.  What the take does not show gets an
    error that is large.
    """
    prior = fit.hypothesis.prior(fit.phi)
    values, vectors = take_away_prior(fit.covariance, prior.stiffness(fit.phi))
    covariance = (vectors / np.maximum(values, LEAST_INFORMATION * values.max())) @ vectors.T
    return -covariance @ prior.slope(fit.phi), np.sqrt(np.diag(covariance))
