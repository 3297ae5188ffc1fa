"""The results of a comparison and of a diagnosis as tables: each cell a number, a number with its error, or a text."""

from collections.abc import Mapping, Sequence
from typing import Literal, NamedTuple

from bcid.documents.diagnosis import DiagnosisDocument, Quantity
from bcid.documents.document import Interval
from bcid.documents.report import ReportDocument


class Estimated(NamedTuple):
    """A number with its standard error; None where either is not known."""

    value: float | None
    se: float | None


class Between(NamedTuple):
    """A number with the ends of its 95 % interval; None where they are not known."""

    value: float | None
    low: float | None
    high: float | None


Cell = str | float | int | bool | Estimated | Between | None


Printing = Literal["thousandths", "as given"]
"""How LaTeX prints the numbers of a column: in units of 10^-3, as an NMSE is told, or with the digits they have."""


class ResultTable(NamedTuple):
    """A table: its name, which becomes that of its files, its caption, and rows of as many cells as there are columns.

    All cells of a column are of one kind; `units` holds the unit of a column, by its name, where all rows share one,
    and `printed` how LaTeX prints it where that is not to three significant digits.
    """

    name: str
    caption: str
    columns: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]
    units: Mapping[str, str] = {}
    printed: Mapping[str, Printing] = {}


def _between(value: float | None, interval: Interval | None) -> Between:
    """A number with its interval, where there is one."""
    return Between(value, *(interval or (None, None)))


def _as_estimate(quantity: Quantity) -> Estimated:
    """A quantity's value and standard error."""
    return Estimated(quantity.value, quantity.se)


def report_tables(report: ReportDocument) -> list[ResultTable]:
    """The tables of a comparison: the models, and the losses where several were compared."""
    take = report.validation.name
    models = ResultTable(
        "models",
        f"Closed-loop error (NMSE) of the models on {take}, which none was fitted on. Restarted: predictions begun "
        f"anew every {report.restart_s:g} s; miss: the median distance from the measured place at their ends",
        ("model", "NMSE", "v_x", "v_y", "yaw rate", "restarted", "miss", "parameters", "rollout"),
        tuple(
            (
                m.model, _between(m.nmse, m.nmse_ci95), m.nmse_vx, m.nmse_vy, m.nmse_yaw_rate, m.nmse_restarted,
                m.end_miss_m, m.parameters, m.rollout_ms,
            )
            for m in report.models
        ),
        {"miss": "m", "rollout": "ms"},
        dict.fromkeys(("NMSE", "v_x", "v_y", "yaw rate", "restarted"), "thousandths"),
    )  # fmt: skip
    losses = ResultTable(
        "losses",
        f"Closed-loop error (NMSE) on {take} of models fitted by different losses",
        ("model", "loss", "NMSE", "restarted"),
        tuple((s.model, s.loss, _between(s.nmse, s.nmse_ci95), s.nmse_restarted) for s in report.losses),
        printed=dict.fromkeys(("NMSE", "restarted"), "thousandths"),
    )
    return [models, losses]


def diagnosis_tables(diagnosis: DiagnosisDocument) -> list[ResultTable]:
    """The tables of a diagnosis: findings, constants, errors and their parts, other figures, what is not seen."""
    takes = ", ".join(diagnosis.recordings)
    findings = ResultTable(
        "findings",
        f"What {takes} shows that the model lacks ({diagnosis.verdict}); ± is one standard error",
        ("effect", "parameter", "value", "unit", "probability", "held-out gain"),
        tuple(
            (f.effect, symbol, _as_estimate(q), q.unit, f.probability, f.heldout_gain)
            for f in diagnosis.findings
            for symbol, q in f.parameters.items()
        ),
        {"held-out gain": "nats"},
    )
    constants = ResultTable(
        "constants",
        f"Constants of the car, fitted to {takes} together with what was found; ± is one standard error",
        ("symbol", "value", "unit", "at a bound"),
        tuple((p.symbol, _as_estimate(p), p.unit, p.at_bound) for p in diagnosis.base.parameters if p.shown),
    )
    horizons = ResultTable(
        "horizons",
        "Closed-loop error (NMSE) on held-out blocks by how far ahead is predicted, before and after the findings",
        ("horizon", "before", "after", "ratio", "with free functions", "noise floor"),
        tuple(
            (
                h.horizon_s, _between(h.nmse_before, h.before_ci95), _between(h.nmse_after, h.after_ci95),
                _between(h.ratio, h.ratio_ci95), _between(h.nmse_remainder, h.remainder_ci95), h.nmse_floor,
            )
            for h in diagnosis.horizons
        ),
        {"horizon": "s"},
        {
            "horizon": "as given",
            **dict.fromkeys(("before", "after", "with free functions", "noise floor"), "thousandths"),
        },
    )  # fmt: skip
    told = diagnosis.error_budget
    budget = ResultTable(
        "budget",
        f"What the closed-loop error {told.horizon_s if told else 0.0:g} s ahead before the findings is made of, on "
        "held-out blocks: shares of it, whose sum is one",
        ("cause", "effects", "share"),
        tuple((p.cause, "+".join(p.effects), _between(p.share, p.ci95)) for p in (told.parts if told else ())),
    )
    others = ResultTable(
        "other_figures",
        "Figures of the simulation that are others in the recording; ± is one standard error",
        ("symbol", "published", "needed", "unit", "gain"),
        tuple(
            (o.symbol, o.published, _as_estimate(o.needed), o.needed.unit, o.gain_nats) for o in diagnosis.other_figures
        ),
        {"gain": "nats"},
    )
    unseen = ResultTable(
        "not_excited",
        "Effects that the drive would not have shown, with the smallest size that it would",
        ("effect", "parameter", "smallest", "unit"),
        tuple(
            (
                n.effect, n.parameter, n.smallest_detectable.value if n.smallest_detectable else None,
                n.smallest_detectable.unit if n.smallest_detectable else "",
            )
            for n in diagnosis.not_excited
        ),
    )  # fmt: skip
    return [findings, constants, horizons, budget, others, unseen]


def heading(table: ResultTable, column: str) -> str:
    """A column's name with its unit, where it has one.

    >>> heading(ResultTable("t", "", ("miss",), (), {"miss": "m"}), "miss")
    'miss (m)'
    """
    unit = table.units.get(column, "")
    return f"{column} ({unit})" if unit else column


def csv_header(table: ResultTable) -> list[str]:
    """The columns of a table as CSV: a number with an error makes two, one with an interval three.

    >>> csv_header(ResultTable("t", "", ("a", "b"), ((Estimated(1.0, 0.1), "x"),)))
    ['a', 'a se', 'b']
    """
    first: Sequence[Cell] = table.rows[0] if table.rows else ()
    names = []
    for column, cell in zip(table.columns, first, strict=True):
        title = heading(table, column)
        more = {Estimated: ["se"], Between: ["low", "high"]}.get(type(cell), [])
        names += [title, *(f"{title} {part}" for part in more)]
    return names


def csv_cells(row: Sequence[Cell]) -> list[str]:
    """The cells of a row as CSV: numbers with all their digits, truth as true and false, nothing where none is known.

    >>> csv_cells(("x", 0.1, True, None, Estimated(2.0, None)))
    ['x', '0.1', 'true', '', '2.0', '']
    """
    flat = [part for cell in row for part in (cell if isinstance(cell, Estimated | Between) else (cell,))]
    return ["" if c is None else str(c).lower() if isinstance(c, bool) else str(c) for c in flat]
