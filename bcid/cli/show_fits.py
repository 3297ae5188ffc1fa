"""What `bcid fit` tells people: scores side by side, constants with errors, how far to believe these, what next."""

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from rich.console import Group
from rich.markup import escape

from bcid.cli.show import score_cells
from bcid.cli.sink import plain_table
from bcid.documents.report import EvaluationDocument
from bcid.evaluation.residuals import ResidualsDocument
from bcid.models.interface import Model
from bcid.models.newton_euler.model import NewtonEuler
from bcid.models.newton_euler.parameters import (
    BIASED_TWISTS,
    errors_lack_bias,
    stated_errors,
    values_of_constants,
)
from bcid.report.formats import format_with_error

SCORE_COLUMNS = ("10³ NMSE", "95 % interval", "v_x", "v_y", "yaw rate")


class ScoredFit(NamedTuple):
    """A model that `bcid fit` made, or found made: where it is, what it is, and how good."""

    name: str  # under which it is saved
    folder: Path  # of its copy in WORKSPACE/models
    artifact: Path
    model: Model
    residuals: ResidualsDocument | None
    score: EvaluationDocument | None  # None where it could not be scored

    def as_json(self) -> dict[str, Any]:
        """The model's entry in the command's JSON."""
        return {
            "model": self.model.name, "name": self.name, "folder": str(self.artifact), "saved": str(self.folder),
            "description": self.model.describe() + "\n",
            "score": self.score and self.score.as_json(), "residuals": self.residuals and self.residuals.as_json(),
        }  # fmt: skip


def fit_tables(fitted: Sequence[ScoredFit], validation: str | None, equations: bool) -> Group:
    """Tables of the fits: their equations where these are asked for, the constants of cars, and the scores at the end.

    `validation` is what the take is called on which they were scored.
    """
    parts: list[Any] = []
    if equations:
        parts += [escape(f"{f.name}\n{f.model.describe()}\n") for f in fitted]
    for f in fitted:
        if rows := constant_rows(f.model):
            parts.append(plain_table(f"constants of {f.name}", ["constant", "fitted", "what it is"], rows))
    scored = any(f.score for f in fitted)
    rows = [
        [f.name, *(score_cells(f.score) if f.score else ["–"] * len(SCORE_COLUMNS)) * scored,
         str(f.model.parameter_count), str(f.folder)]
        for f in fitted
    ]  # fmt: skip
    title = f"closed loop on {validation}, as in bcid report" if scored else "fitted models"
    parts.append(plain_table(title, ["model", *SCORE_COLUMNS * scored, "parameters", "saved in"], rows))
    return Group(*parts)


def constant_rows(model: object) -> list[list[str]]:
    """Rows of the table of a car's fitted constants: symbol, value ± standard error, meaning; none of other models."""
    if not isinstance(model, NewtonEuler):
        return []
    facts, rows = model.facts, list[list[str]]()
    values, errors = values_of_constants(model.car, facts), stated_errors(model.car, facts)
    for symbol, about in facts.get("fitted", {}).items():
        error = errors[symbol]
        text = "not identified" if error is None else format_with_error(values[symbol], error, about["unit"])
        rows.append([symbol, text, about["meaning"]])
    return rows


def warnings_of_fits(fitted: Iterable[ScoredFit]) -> list[str]:
    """What must be known of fits that state standard errors.

    One sentence for each whose residuals are too large, one for each fitted by another loss than that of poses.
    """
    return [f"{f.name}: {text}" for f in fitted if constant_rows(f.model) for text in _doubts_of_errors(f)]


def _doubts_of_errors(fit: ScoredFit) -> list[str]:
    """Why the standard errors of a car's constants are not the whole of their errors, a sentence for each reason."""
    biased = isinstance(fit.model, NewtonEuler) and errors_lack_bias(fit.model.facts)
    lacking = describe_residuals(fit.residuals) if fit.residuals else ""
    return [text for text in (lacking, BIASED_TWISTS if biased else "") if text]


def describe_residuals(residuals: ResidualsDocument) -> str:
    """A sentence that the standard errors are too small, where a model's residuals say so; empty where they do not."""
    if not residuals.show_missing_physics:
        return ""
    return (
        f"over {residuals.horizon_s:g} s it misses its own takes by {residuals.multiple:.1f} times what a model that "
        "lacks nothing would: physics is missing, so the ± are too small by an unknown amount; "
        "`bcid diagnose` says what is missing"
    )


def next_steps(fitted: Sequence[ScoredFit]) -> str:
    """What to type next with the best of the fitted models."""
    name = fitted[0].name
    return f"next: bcid report compares them on a page; bcid export {name} writes code; --equations prints equations"
