"""An export on disk: the files of each format, checked before any of them is there, and NAME.json about all of them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from bcid import __version__
from bcid.aliases import Progress
from bcid.documents.export import ExportDocument, ExportedFormat, ExportedQuantity, ExportedStart, ExportedVectors
from bcid.documents.report import ProcessNoiseFigures
from bcid.evaluation.validity import QUANTITIES
from bcid.export.check import Checked
from bcid.export.commands import steering_limit_of
from bcid.export.exported import Exported
from bcid.export.formats import FORMATS
from bcid.export.formulas import Variable
from bcid.files.outputs import MayReplace, staged_outputs


def write_export(
    e: Exported, formats: Sequence[str], folder: Path, may_replace: MayReplace, progress: Progress
) -> ExportDocument:
    """Write an export in some `formats` into `folder`, with NAME.json; returns what that holds.

    Raises:
        InputRefused: a format does not do what the model does, and nothing is written; or a file would be overwritten.
        DiskFull: the disk is full.
    """
    made, chosen = [], _with_needed(formats)
    with staged_outputs(folder, may_replace) as staged:
        for i, name in enumerate(chosen):
            progress(i / len(chosen), name)
            files = FORMATS[name].write(e)
            for file, content in files.items():
                (staged / file).write_bytes(content.encode("utf-8") if isinstance(content, str) else content)
            check = FORMATS[name].check
            checked = check(staged, e) if check else Checked(None, "it holds no equations")
            made.append(
                ExportedFormat(format=name, files=tuple(files), error=checked.error, not_checked=checked.not_checked)
            )
        document = _describe(e, made)
        document.write(staged / f"{e.name}.json")
    return document


def _with_needed(formats: Sequence[str]) -> list[str]:
    """The `formats` and those that they need, in the order of the table."""
    wanted = {needed for name in formats for needed in (name, *FORMATS[name].needs)}
    return [name for name in FORMATS if name in wanted]


def _describe(e: Exported, made: Sequence[ExportedFormat]) -> ExportDocument:
    """What NAME.json says of an export whose formats are `made`."""
    noise = e.validity.noise if e.validity else None
    results = (*e.formulas.results, *e.formulas.first_states)
    parameters = [node for node in e.formulas.graph.nodes_for(results) if node.operation == "parameter"]
    return ExportDocument(
        kind="bcid.export/1", name=e.name, model=e.model.name, model_digest=e.digest, made_by=f"bcid {__version__}",
        of="vehicle" if e.without_measurement else "recording", time_s=e.time_s, point=e.point,
        period_s=e.formulas.period_s, states=_quantities(e, e.formulas.states), commands=_quantities(e, e.commands),
        twist=_quantities(e, e.twist), steering_limit_rad=steering_limit_of(e.model),
        constants={node.name: float(node.value or 0.0) for node in parameters},
        process_noise=noise and ProcessNoiseFigures(**noise._asdict()), formats=tuple(made), vectors=_vectors(e),
    )  # fmt: skip


def _quantities(e: Exported, quantities: Sequence[Variable]) -> tuple[ExportedQuantity, ...]:
    """Quantities with their range over the data that the model was fitted on, where it is known."""
    names = list(QUANTITIES)
    ranges = dict[str, tuple[float, float]]()
    if e.validity:
        ranges = {n: (low, high) for n, low, high in zip(names, *e.validity.range, strict=True)}
    return tuple(
        ExportedQuantity(name=q.name, unit=q.unit, meaning=q.meaning, low=low, high=high)
        for q in quantities
        for low, high in [ranges.get(q.name, (None, None))]
    )


def _vectors(e: Exported) -> ExportedVectors:
    """The drive by which the formats were checked, as NAME.json holds it."""
    v = e.vectors

    def rows(table: np.ndarray) -> tuple[tuple[float, ...], ...]:
        return tuple(map(tuple, table.tolist()))

    return ExportedVectors(
        pose=tuple(v.pose.tolist()), twist=tuple(v.twist.tolist()), delta=v.delta, commands=rows(v.commands),
        twists=rows(v.twists), states=None if v.states is None else rows(v.states), tolerance=v.tolerance,
        end_pose=tuple(v.end_pose.tolist()),
        starts=tuple(
            ExportedStart(
                pose=tuple(start.pose.tolist()), twist=tuple(start.twist.tolist()), delta=start.delta,
                state=tuple(start.state.tolist()),
            )
            for start in v.starts
        ),
    )  # fmt: skip
