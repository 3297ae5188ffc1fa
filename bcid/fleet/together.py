"""What the diagnoses of a fleet's logs say together: effects of the fleet, and parameters that are others on a day."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from bcid.aliases import Floats
from bcid.documents.diagnosis import DiagnosisDocument, Quantity
from bcid.documents.fleet import (
    PRESENT,
    DayValue,
    FleetDiagnosis,
    FleetEffect,
    FleetParameter,
    LogValue,
    MovedParameter,
)
from bcid.effects.table import EFFECTS
from bcid.fleet.labels import LogLabel
from bcid.fleet.limits import LIMITS
from bcid.fleet.log_evidence import LogEvidence
from bcid.fleet.moved import Contrast, DayModel, fit_days, reject_at_false_share
from bcid.fleet.occurrences import Occurrence, find_occurrences


class DiagnosedLog(NamedTuple):
    """A log of a fleet, when it was driven, and what its diagnosis says."""

    name: str
    label: LogLabel
    document: DiagnosisDocument


class _Series(NamedTuple):
    """One parameter in the logs that show it."""

    symbol: str
    unit: str
    logs: tuple[DiagnosedLog, ...]
    values: Floats  # (I,)
    errors: Floats  # (I,) standard errors
    relative: bool  # whether it is compared by its logarithm: it has one sign everywhere, and is known well

    def values_to_compare(self) -> tuple[Floats, Floats]:
        """Values and standard errors (I,) of what is compared: the parameter, or the logarithm of its size."""
        size = np.abs(self.values)
        return (np.log(size), self.errors / size) if self.relative else (self.values, self.errors)

    def as_value(self, compared: float) -> float:
        """The parameter itself, of what is compared."""
        return float(np.sign(self.values[0]) * np.exp(compared)) if self.relative else compared


def diagnose_together(logs: Sequence[DiagnosedLog], days: Sequence[str]) -> FleetDiagnosis | None:
    """What two logs or more say together, `days` being those of the fleet in their order; None of fewer logs."""
    if len(logs) < 2:
        return None
    driven = [day for day in days if any(log.label.day == day for log in logs)]
    index = [driven.index(log.label.day) for log in logs]
    evidence = [LogEvidence.of_diagnosis(log.document) for log in logs]
    occurrences = find_occurrences(evidence, index, [log.label.car for log in logs])
    named = _logs_that_name_what_they_have(logs, occurrences)
    followed = {log.name for log in named}
    parameters, moved = _follow_parameters(logs, named, driven, occurrences)
    return FleetDiagnosis(
        days=tuple(driven), without=tuple(day for day in days if day not in driven),
        effects=tuple(_describe_effect(each, logs, evidence, driven) for each in occurrences),
        moved=tuple(moved), parameters=tuple(parameters),
        left_out=tuple(log.name for log in logs if log.name not in followed),
    )  # fmt: skip


def _describe_effect(
    occurrence: Occurrence, logs: Sequence[DiagnosedLog], evidence: Sequence[LogEvidence], days: Sequence[str]
) -> FleetEffect:
    """An effect of the fleet as it is written; logs whose evidence says nothing of it are left out."""
    named = occurrence.effect
    in_logs = {
        log.name: round(p, 4)
        for log, p, shown in zip(logs, occurrence.in_logs.tolist(), evidence, strict=True)
        if named in shown.effects
    }
    in_cars = dict[str, float]()
    for log in logs:
        if log.label.car and log.name in in_logs:  # a car that has it once has it in all later logs
            in_cars[log.label.car] = max(in_cars.get(log.label.car, 0.0), in_logs[log.name])
    return FleetEffect(
        effect=named, probability=occurrence.probability, evidence_nats=round(occurrence.nats, 2),
        twins=occurrence.twins, since=days[occurrence.day], since_probability=round(occurrence.day_probability, 4),
        share=round(occurrence.share, 4), share_ci90=occurrence.share_interval, in_logs=in_logs,
        in_cars=in_cars,
    )  # fmt: skip


def _follow_parameters(
    logs: Sequence[DiagnosedLog], named: Sequence[DiagnosedLog], days: Sequence[str], occurrences: Sequence[Occurrence]
) -> tuple[list[FleetParameter], list[MovedParameter]]:
    """The parameters of the car and of the fleet's effects over the logs, and those that are others on a later day.

    Those of the car are of the logs in `named` alone.
    Of the changes that are reported a share of `LIMITS.false_share` is expected to be false; their intervals allow for
    that they were chosen (Benjamini and Yekutieli 2005).
    """
    series = _car_series(named) + [s for each in occurrences for s in _effect_series(logs, each)]
    models = [
        fit_days(
            *s.values_to_compare(), [days.index(log.label.day) for log in s.logs], [log.label.car for log in s.logs]
        )
        for s in series
    ]
    changes = [(s, model, change) for s, model in zip(series, models, strict=True) if model for change in model.changes]
    certain = reject_at_false_share([change.p_value for _, _, change in changes], LIMITS.false_share)
    level = 1.0 - LIMITS.false_share * sum(certain) / max(len(certain), 1)
    moved = [
        _describe_change(s, model, change, days, level)
        for (s, model, change), reported in zip(changes, certain, strict=True) if reported
    ]  # fmt: skip
    parameters = [_describe_parameter(s, model, days) for s, model in zip(series, models, strict=True)]
    return parameters, sorted(moved, key=lambda each: each.p_value)


def _logs_that_name_what_they_have(
    logs: Sequence[DiagnosedLog], occurrences: Sequence[Occurrence]
) -> list[DiagnosedLog]:
    """The logs whose constants of the car were fitted beside all effects of the fleet that they have.

    In the others an effect that is there, and has no name, has moved the constants: they would seem to be others on the
    day on which it came.
    """
    return [
        log for i, log in enumerate(logs)
        if all(o.in_logs[i] <= PRESENT or {f.effect for f in log.document.findings} & {o.effect, *o.twins}
               for o in occurrences)
    ]  # fmt: skip


def _car_series(logs: Sequence[DiagnosedLog]) -> list[_Series]:
    """The parameters of the car in the logs that show them.

    Beside a simulation they are what each log alone shows: figures that are drawn to the same published one would seem
    to be alike.
    """
    tables = [
        {
            p.symbol: p.of_recording if log.document.compared_with == "simulation" else p
            for p in log.document.base.parameters if p.shown and not p.at_bound
        }
        for log in logs
    ]  # fmt: skip
    symbols = dict.fromkeys(symbol for table in tables for symbol in table)
    made = [_make_series(symbol, logs, [table.get(symbol) for table in tables]) for symbol in symbols]
    return [series for series in made if series]


def _effect_series(logs: Sequence[DiagnosedLog], occurrence: Occurrence) -> list[_Series]:
    """The sizes of an effect in the logs that have it; none where one of these does not name it.

    It would be one that shows little of it, and those that are left would not be like the fleet.  Places and times are
    no sizes.
    """
    effect, held = occurrence.effect, [log for log, p in zip(logs, occurrence.in_logs, strict=True) if p > PRESENT]
    findings = [next((f for f in log.document.findings if f.effect == effect), None) for log in held]
    if effect not in EFFECTS or any(finding is None for finding in findings):
        return []
    sizes = [p.symbol for p in EFFECTS[effect].parameters if not p.is_place]
    tables = [finding.parameters if finding else {} for finding in findings]
    made = [
        _make_series(f"{effect}.{symbol}", held, [table.get(symbol) for table in tables])
        for symbol in dict.fromkeys(s for table in tables for s in table)
        if symbol in sizes
    ]
    return [series for series in made if series]


def _make_series(symbol: str, logs: Sequence[DiagnosedLog], quantities: Sequence[Quantity | None]) -> _Series | None:
    """One parameter in those of the logs in which it is known, and not at a bound; None where there are not two."""
    known = [
        (log, q) for log, q in zip(logs, quantities, strict=True)
        if q and q.value is not None and q.se and not q.at_bound
    ]  # fmt: skip
    if len(known) < 2:
        return None
    values = np.array([float(q.value or 0.0) for _, q in known])
    errors = np.array([float(q.se or 0.0) for _, q in known])
    relative = bool(
        abs(np.sign(values).sum()) == len(values) and (errors < LIMITS.most_relative_se * abs(values)).all()
    )
    return _Series(symbol, known[0][1].unit, tuple(log for log, _ in known), values, errors, relative)


def _describe_parameter(series: _Series, model: DayModel | None, days: Sequence[str]) -> FleetParameter:
    """A parameter over the logs as it is written, with its mean on each day."""
    return FleetParameter(
        symbol=series.symbol, unit=series.unit, scatter=model.tau if model else None,
        days=tuple(_describe_mean(series, mean, days) for mean in (model.means if model else ())),
        logs=tuple(
            LogValue(log=log.name, day=log.label.day, value=value, se=se)
            for log, value, se in zip(series.logs, series.values.tolist(), series.errors.tolist(), strict=True)
        ),
    )  # fmt: skip


def _describe_mean(series: _Series, mean: Contrast, days: Sequence[str]) -> DayValue:
    """The mean of a parameter on a day as it is written."""
    low, high = sorted(series.as_value(x) for x in mean.interval())
    return DayValue(day=days[mean.day], mean=series.as_value(mean.value), ci95=(low, high))


def _describe_change(
    series: _Series, model: DayModel, change: Contrast, days: Sequence[str], level: float
) -> MovedParameter:
    """By how much a parameter differs on a later day from the first on which it is known, with its interval."""
    value, (low, high), se = change.value, change.interval(level), change.se
    if series.relative:
        value, low, high = (float(np.expm1(x)) for x in (value, low, high))
        se *= 1.0 + value
    return MovedParameter(
        symbol=series.symbol, day=days[change.day], beside=days[model.first_day], change=value, se=se,
        interval=(low, high), relative=series.relative, unit="" if series.relative else series.unit,
        p_value=change.p_value,
    )  # fmt: skip
