"""`bcid compare`: two runs side by side; is it the same car as last week?"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

import typer

from bcid.cli import options
from bcid.cli.completion import complete_saved_models
from bcid.cli.options import Format

if TYPE_CHECKING:
    from rich.console import RenderableType

    from bcid.documents.comparison import ComparisonDocument, ModelComparison

RUN_HELP = "A workspace, the folder of a diagnosis, or a saved model by its name or folder"


def compare(
    one: Annotated[str, typer.Argument(help=f"{RUN_HELP}.", autocompletion=complete_saved_models)],
    other: Annotated[
        str, typer.Argument(help=f"{RUN_HELP}, to compare with it.", autocompletion=complete_saved_models)
    ],
    pipeline: options.WorkspaceOption = None,
    format: options.FormatOption = Format.human,  # noqa: A002
) -> None:
    """Say whether two runs show the same car: constants side by side with their errors, and what only one found."""
    from bcid.cli.sink import Sink
    from bcid.pipeline.compare_runs import compare_runs

    sink = Sink(format)
    document = compare_runs(one, other, lambda: options.workspace_of(pipeline))
    sink.result(document.as_json(), lambda: _tables(document))
    for model in document.models:
        for text in model.cautions:
            sink.note(f"warning: {text}")
        for text in model.notes:
            sink.note(f"note: {text}")


def _tables(document: ComparisonDocument) -> RenderableType:
    """Each compared model as a table of its constants, with what only one run found, and the verdict below."""
    from rich.console import Group
    from rich.markup import escape

    parts: list[Any] = []
    for model in document.models:
        parts += [_constants_table(document, model), *map(escape, _lone_lines(model)), escape(f"{model.sentence}\n")]
    return Group(*parts)


def _constants_table(document: ComparisonDocument, model: ModelComparison) -> RenderableType:
    """The constants of both runs with their errors, change and z; those that differ are marked."""
    from bcid.cli.sink import plain_table
    from bcid.report.formats import format_number, format_with_error, with_minus_sign

    rows = [
        [
            c.symbol, format_with_error(c.one.value, c.one.se, c.one.unit),
            format_with_error(c.other.value, c.other.se, c.other.unit),
            format_with_error(c.change, c.change_se),
            "–" if c.share is None else with_minus_sign(f"{100 * c.share:+.2g} %"),
            with_minus_sign(f"{c.z:+.1f}"), format_number(c.least_visible, 2), "differs" if c.differs else "",
        ]
        for c in model.constants
    ]  # fmt: skip
    same_name = model.one == model.other
    names = (model.one,) if same_name else (model.one, model.other)
    columns = ["constant", document.one, document.other, "change", "in %", "σ", "least that would show", ""]
    caption = f"beyond {model.z_needed:.1f} σ a change is more than chance, of all {len(rows)} constants together"
    return plain_table(" and ".join(names), columns, rows, caption if rows else "")


def _lone_lines(model: ModelComparison) -> list[str]:
    """What only one of two diagnoses found, and which constants only one identifies, a line each."""
    lines = [
        f"only in the {'first' if f.found_in == 'one' else 'second'}: {f.sentence or f.effect}"
        + (f" (this proves nothing: {f.why_not})" if f.why_not else "")
        for f in model.lone_findings
    ]
    told = {f.effect for f in model.lone_findings}
    for place, symbols in (("first", model.only_one), ("second", model.only_other)):
        constants = [s for s in symbols if s.split(" ")[0] not in told]
        if constants:
            lines.append(f"identified in the {place} only: {', '.join(constants)}")
    return lines
