"""What the diagnoses of a fleet's logs say together: effects of the fleet, and parameters that are others on a day."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from bcid.documents.diagnosis import DiagnosisDocument, Quantity
from bcid.documents.fleet import (
    DayValue,
    FleetDiagnosis,
    FleetEffect,
    FleetParameter,
    LogValue,
    MovedParameter,
)
from bcid.fleet.labels import LogLabel
from bcid.fleet.limits import LIMITS
from bcid.fleet.log_evidence import LogEvidence
from bcid.fleet.moved import DayModel, fit_days, reject_at_false_share
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
    quantities: tuple[Quantity, ...]
    relative: bool  # whether it is compared by its logarithm: it has one sign everywhere

    def columns(self) -> tuple[np.ndarray, np.ndarray]:
        """Values and standard errors (I,) of what is compared: the parameter, or its logarithm."""
        value = np.array([float(q.value or 0.0) for q in self.quantities])
        se = np.array([float(q.se or 0.0) for q in self.quantities])
        return (np.log(np.abs(value)), se / np.abs(value)) if self.relative else (value, se)


def diagnose_together(logs: Sequence[DiagnosedLog]) -> FleetDiagnosis | None:
    """What two logs or more say together; None of fewer."""
    if len(logs) < 2:
        return None
    days = sorted({log.label.day for log in logs})
    index = [days.index(log.label.day) for log in logs]
    cars = [log.label.car for log in logs]
    evidence = [LogEvidence.of_diagnosis(log.document) for log in logs]
    found = find_occurrences(evidence, index, cars)
    parameters, moved = _follow_parameters(logs, days, [occurrence.effect for occurrence in found])
    return FleetDiagnosis(
        days=tuple(days), effects=tuple(_describe_effect(o, logs, evidence, days) for o in found),
        moved=tuple(moved), parameters=tuple(parameters),
    )  # fmt: skip


def _describe_effect(
    found: Occurrence, logs: Sequence[DiagnosedLog], evidence: Sequence[LogEvidence], days: Sequence[str]
) -> FleetEffect:
    """An effect of the fleet as it is written; logs whose evidence says nothing of it are left out."""
    says = [each.nats(found.effect) is not None for each in evidence]
    return FleetEffect(
        effect=found.effect, probability=found.probability, evidence_nats=round(found.nats, 2), twins=found.twins,
        since=days[found.day], since_probability=round(found.day_probability, 4), share=round(found.share, 4),
        share_ci90=found.share_interval,
        in_logs={
            log.name: round(p, 4)
            for log, p, known in zip(logs, found.in_logs.tolist(), says, strict=True) if known
        },
    )  # fmt: skip


def _follow_parameters(
    logs: Sequence[DiagnosedLog], days: Sequence[str], effects: Sequence[str]
) -> tuple[list[FleetParameter], list[MovedParameter]]:
    """The parameters of the car and of `effects` over the logs, and those that are others on a later day.

    Of the changes that are told a share of `LIMITS.false_share` is expected to be false.
    """
    parameters, changes = list[FleetParameter](), list[MovedParameter]()
    for series in _series_of_parameters(logs, effects):
        index = [days.index(log.label.day) for log in series.logs]
        model = fit_days(*series.columns(), index, [log.label.car for log in series.logs])
        parameters.append(_describe_parameter(series, model, days))
        changes += _describe_changes(series, model, days) if model else []
    told = reject_at_false_share([change.p_value for change in changes], LIMITS.false_share)
    moved = [change for change, is_told in zip(changes, told, strict=True) if is_told]
    return parameters, sorted(moved, key=lambda change: change.p_value)


def _series_of_parameters(logs: Sequence[DiagnosedLog], effects: Sequence[str]) -> list[_Series]:
    """Parameters of the car, then those of `effects`, in the logs that show them."""
    tables = [_shown_parameters(log.document, effects) for log in logs]
    series = list[_Series]()
    for symbol in dict.fromkeys(name for table in tables for name in table):
        having = [(log, table[symbol]) for log, table in zip(logs, tables, strict=True) if symbol in table]
        values = [float(q.value or 0.0) for _, q in having]
        one_sign = min(values) > 0.0 or max(values) < 0.0
        known_by_its_size = all(
            float(q.se or 0.0) < LIMITS.most_relative_se * abs(float(q.value or 0.0)) for _, q in having
        )
        if len(having) > 1:
            series.append(_Series(
                symbol, having[0][1].unit, tuple(log for log, _ in having), tuple(q for _, q in having),
                one_sign and known_by_its_size,
            ))  # fmt: skip
    return series


def _shown_parameters(document: DiagnosisDocument, effects: Sequence[str]) -> dict[str, Quantity]:
    """The parameters that a log shows, by symbol: the car's, and those of `effects` that it names as effect.symbol."""
    table: dict[str, Quantity] = {p.symbol: p for p in document.base.parameters if p.shown and not p.at_bound}
    for finding in document.findings:
        if finding.effect in effects:
            table |= {f"{finding.effect}.{symbol}": q for symbol, q in finding.parameters.items() if not q.at_bound}
    return {symbol: q for symbol, q in table.items() if q.value is not None and q.se}


def _describe_parameter(series: _Series, model: DayModel | None, days: Sequence[str]) -> FleetParameter:
    """A parameter over the logs as it is written, with its mean on each day."""
    means = list[DayValue]()
    for each in model.means if model else ():
        mean = float(np.exp(each.mean)) * _sign(series) if series.relative else each.mean
        means.append(DayValue(day=days[each.day], mean=mean, se=each.se * (abs(mean) if series.relative else 1.0)))
    return FleetParameter(
        symbol=series.symbol, unit=series.unit, scatter=model.tau if model else None, days=tuple(means),
        logs=tuple(
            LogValue(log=log.name, day=log.label.day, value=float(q.value or 0.0), se=float(q.se or 0.0))
            for log, q in zip(series.logs, series.quantities, strict=True)
        ),
    )  # fmt: skip


def _sign(series: _Series) -> float:
    """The sign that a parameter has in all logs."""
    return -1.0 if float(series.quantities[0].value or 0.0) < 0.0 else 1.0


def _describe_changes(series: _Series, model: DayModel, days: Sequence[str]) -> list[MovedParameter]:
    """By how much a parameter differs on each later day from the first, whether that is certain or not."""
    rows = []
    for each in model.changes:
        low, high = each.change - each.half_width, each.change + each.half_width
        change, se = each.change, each.se
        if series.relative:
            low, high, change = (float(np.expm1(x)) for x in (low, high, change))
            se *= 1.0 + change
        rows.append(MovedParameter(
            symbol=series.symbol, day=days[each.day], beside=days[model.means[0].day], change=change, se=se,
            ci95=(low, high), relative=series.relative, unit="" if series.relative else series.unit,
            p_value=each.p_value,
        ))  # fmt: skip
    return rows
