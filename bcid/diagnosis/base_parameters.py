"""The parameters of a diagnosis's base model as they are written: those of its fit, and what the take alone shows."""

import numpy as np

from bcid.aliases import Floats
from bcid.diagnosis.limits import SUMMARY_LIMITS
from bcid.documents import diagnosis as written
from bcid.effects.table import effect_ids
from bcid.likelihood.hypothesis import DRAG
from bcid.likelihood.refit import Fit
from bcid.models.newton_euler.parameters import constant_units

LEAST_INFORMATION = 1e-9  # of a direction of phi beside the best known one: rounding may leave less than none


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
    change, se_alone = (
        without_trust(fit) if hypothesis.trusted_simulation is not None else (se, np.full_like(se, np.inf))
    )
    own = []
    for k, s in enumerate((*hypothesis.log_parameters, *DRAG)):
        value, scale, is_drag = float(getattr(car, s)), float(scales[k]), s in DRAG
        shown = [bool(e < SUMMARY_LIMITS.max_relative_se or is_drag) for e in (se[k], se_alone[k])]
        alone = None
        if shown[1] and np.isfinite(se_alone[k]) and not stuck[k]:
            there = value + scale * change[k] if is_drag else value * np.exp(change[k])
            error = abs(scale if is_drag else there) * se_alone[k]
            alone = written.Quantity(value=float(there), se=float(error), unit=units[s])
        own.append(
            written.BaseParameter(
                symbol=s, value=value, se=float(abs(scale) * se[k]), unit=units[s], shown=shown[0], at_bound=stuck[k],
                of_recording=alone,
            )
        )  # fmt: skip
    return own + [
        written.BaseParameter(
            symbol=field.replace("__", "."), value=values[field][0], se=values[field][1], unit=p.unit, at_bound=at_end
        )
        for (field, p), at_end in zip(hypothesis.effect_parameters, stuck[hypothesis.base_size :], strict=True)
        if effect_ids([field])[0] in hypothesis.assumed
    ]


def without_trust(fit: Fit) -> tuple[Floats, Floats]:
    """By how much phi (n,) of a fit is another by its take alone, and with which standard errors (n,).

    At a fit the slopes of likelihood and prior cancel: the likelihood alone, of the curvature that is left without the
    prior's, is greatest where its slope, the prior's with the other sign, leads.  What the take does not show gets an
    error that is large.
    """
    prior = fit.hypothesis.prior(fit.phi)
    information = np.linalg.pinv(fit.covariance, hermitian=True) - np.diag(prior.stiffness(fit.phi))
    values, vectors = np.linalg.eigh(0.5 * (information + information.T))
    covariance = (vectors / np.maximum(values, LEAST_INFORMATION * values.max())) @ vectors.T
    return -covariance @ prior.slope(fit.phi), np.sqrt(np.diag(covariance))
