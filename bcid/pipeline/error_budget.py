"""What the held-out prediction error of a diagnosis's base model is made of: each finding, noise, and the rest.

For every set of findings the car with these and no others is fitted to the poses, and predicted closed loop, 2 s ahead,
on blocks that its parameters have not seen: as for the page's table of errors, they are refitted to the other half of
the take.  All parameters are fitted anew with every set, so that what a finding explains is what no other choice of the
base model's does.
"""

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from bcid.aliases import Floats, Ints
from bcid.diagnosis.diagnose import Diagnosis
from bcid.diagnosis.judge.fitted_models import model_from_fit, refit_on_half_or_keep, squared_errors
from bcid.diagnosis.judge.held_out import block_length_s, split_halves
from bcid.diagnosis.judge.prediction_error import simulate_fitted_car
from bcid.diagnosis.search.refits import fitted_corrections, refit_with_effects
from bcid.documents.error_budget import Cause, ErrorBudget, ErrorShare
from bcid.errors import InputRefused
from bcid.estimate.run import estimate_motion
from bcid.estimate.tuning import Tuning
from bcid.estimate.types import Estimate
from bcid.evaluation.closed_loop import predict_with_restarts
from bcid.evaluation.error_budget import ErrorPart, ErrorParts, apportion_error, errors_of_sets
from bcid.likelihood.divergence import none_if_diverged
from bcid.likelihood.refit import Fit, refit
from bcid.likelihood.take import Take, build_take
from bcid.models.fitting.windows import inverse_spread
from bcid.pipeline.limits import LIMITS
from bcid.recording.types import Recording
from bcid.vehicle import Vehicle

HORIZON_S = 2.0
CORRECTIONS = "the base model's own simplifications"
"""The name under which all corrections together are one source."""

CHANCE: tuple[Cause, ...] = ("noise", "disturbances")
"""Parts of the error that a perfect model would have, in the order of `_floor_squares`."""

ErrorSources = dict[str, tuple[str, ...]]
"""Ids of the effects that are switched on together, by the name of what they are."""


def measure_error_budget(
    diagnosis: Diagnosis, recording: Recording, estimate: Estimate, vehicle: Vehicle, tuning: Tuning
) -> ErrorBudget | None:
    """What the held-out error (NMSE, HORIZON_S ahead) of the base model is made of, on a diagnosis's first recording.

    `estimate` is the recording's smoothed motion, with the `tuning` of the filter.  Where findings and corrections are
    more than `LIMITS.max_budget_sources`, the last findings are one together.  None where a set of them has no
    prediction that stays finite.
    """
    sources, block, fits = (
        _error_sources(diagnosis),
        _blocks(estimate, recording, diagnosis.take),
        _refit_every_set(diagnosis),
    )
    own, weights = frozenset(diagnosis.naming.base.hypothesis.effects), inverse_spread(estimate.twist)

    def held_out_squares(chosen: frozenset[str]) -> Floats:
        """Squared errors (K,) on held-out blocks of the car with the sources `chosen` by name; NaN if it diverges."""
        on = own.union(*(sources[name] for name in chosen))
        ordered = tuple(name for name in diagnosis.fit.hypothesis.effects if name in on)
        fit = fits.get(on) or none_if_diverged(refit_with_effects, diagnosis.fit, diagnosis.take, ordered)
        return (
            _held_out_squares(fit, diagnosis.take, estimate, block, weights) if fit else np.full(len(estimate), np.nan)
        )

    floor, floor_block = _floor_squares(diagnosis, recording, vehicle, tuning, estimate)
    try:
        parts = apportion_error(errors_of_sets(tuple(sources), held_out_squares), block, floor, floor_block)
    except ValueError:
        return None
    return ErrorBudget(horizon_s=HORIZON_S, nmse=parts.error, parts=_describe_parts(parts, sources))


def _describe_parts(parts: ErrorParts, sources: ErrorSources) -> tuple[ErrorShare, ...]:
    """The parts of an error as the document holds them, findings first, the largest first, and the rest last.

    Without a floor what is left holds the noise, too, and is not called unexplained.
    """
    explained = [
        _share("corrections" if name == CORRECTIONS else "effect", part, effects)
        for (name, effects), part in zip(sources.items(), parts.explained, strict=True)
    ]
    explained.sort(key=lambda s: (s.cause == "corrections", -s.share))
    chance = [_share(cause, part) for cause, part in zip(CHANCE, parts.floor, strict=False)]
    rest = _share("unexplained" if parts.floor else "left-noise-included", parts.unexplained)
    return (*explained, *chance, rest)


def _share(cause: Cause, part: ErrorPart, effects: Iterable[str] = ()) -> ErrorShare:
    """One part of the error as the document holds it."""
    return ErrorShare(cause=cause, effects=tuple(effects), share=part.share, ci95=part.ci95)


def _error_sources(diagnosis: Diagnosis) -> ErrorSources:
    """What is switched on and off: findings and, as one source, corrections; of too many findings the last together."""
    findings, corrections = [f.effect for f in diagnosis.judgement.findings], fitted_corrections(diagnosis.fit)
    most = LIMITS.max_budget_sources - bool(corrections)
    alone = findings if len(findings) <= most else findings[: most - 1]
    sources: ErrorSources = {name: (name,) for name in alone}
    rest = tuple(findings[len(alone) :])
    return sources | ({"+".join(rest): rest} if rest else {}) | ({CORRECTIONS: corrections} if corrections else {})


def _refit_every_set(diagnosis: Diagnosis) -> dict[frozenset[str], Fit]:
    """Fits to the whole take that the search has made, with all findings, some, or none of them, by their effects."""
    naming = diagnosis.naming
    fits = [*naming.without.values(), naming.corrected, naming.base, naming.best]
    return {frozenset(fit.hypothesis.effects): fit for fit in fits}


def _blocks(estimate: Estimate, recording: Recording, take: Take) -> Ints:
    """Number (K,) of the block, for cross-validation and bootstrap, that each row of the estimated motion lies in."""
    begin_s: Floats = estimate.time_s - recording.poses.time_s[0]
    return np.asarray(begin_s // block_length_s(take), dtype=np.int64)


def _held_out_squares(fit: Fit, take: Take, estimate: Estimate, block: Ints, weights: Floats) -> Floats:
    """Squared errors (K,) of a fitted car, each row predicted with parameters refitted to the blocks of the other half.

    Errors of the twist's components are multiplied by `weights` (3,).  Where such a refit diverges, the parameters are
    those of the whole take.
    """
    T, period_s = float(take.length_s[0]), estimate.period_s
    models = [model_from_fit(refit_on_half_or_keep(fit, take, half), T, period_s) for half in split_halves(take)]
    predictions = [predict_with_restarts(model, estimate, HORIZON_S) for model in models]
    return np.where(block % 2 == 1, *(squared_errors(predicted, estimate, weights) for predicted in predictions))


def _floor_squares(
    diagnosis: Diagnosis, recording: Recording, vehicle: Vehicle, tuning: Tuning, estimate: Estimate
) -> tuple[Floats, Ints]:
    """Squared errors (2, K') of the fitted car on its own simulated drive, and the blocks (K',) of their rows.

    The first part is what the noise of the poses makes; the second what disturbances that look random add, of the
    standard deviations that the fit found.  There are no parts, (0, K'), where the car cannot be simulated that long,
    or its simulated drive cannot be fitted.
    """
    fit, take, weights = diagnosis.fit, diagnosis.take, inverse_spread(estimate.twist)
    still = replace(fit, scales=fit.scales._replace(q=np.zeros_like(fit.scales.q)))
    rows = []
    for source in (still, fit):
        simulated = none_if_diverged(simulate_fitted_car, source, take, recording)
        if simulated is None:
            return np.zeros((0, len(estimate))), _blocks(estimate, recording, take)
        again = estimate_motion(simulated, vehicle, tuning, estimate.period_s)
        refitted = _refit_to_simulated(fit, simulated, again)
        if refitted is None:
            return np.zeros((0, len(estimate))), _blocks(estimate, recording, take)
        block = _blocks(again, simulated, refitted[1])
        rows.append((_held_out_squares(*refitted, again, block, weights), block))
    (noise, block), (both, _) = rows
    return np.stack([noise, both - noise]), block


def _refit_to_simulated(fit: Fit, simulated: Recording, estimate: Estimate) -> tuple[Fit, Take] | None:
    """The car of a `fit` fitted to its own simulated drive, and the take of that; None where it cannot be.

    Its parameters are then as far off as those of the measured drive, by noise and disturbances.  Of several
    recordings the first alone is simulated, so that they are a little farther off.
    """
    try:
        take, _ = build_take([simulated], [estimate], fit.car(), fit.hypothesis.angle_limit)
    except InputRefused:
        return None
    again = none_if_diverged(refit, take, fit.hypothesis, fit.phi, take.start, fit.scales)
    return (again, take) if again else None
