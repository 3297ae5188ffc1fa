"""An export on disk: the files of each format, checked before any of them is there, and NAME.json about all of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from bcid import __version__
from bcid.aliases import Progress
from bcid.documents.export import ExportDocument, ExportedFormat, ExportedQuantity, ExportedStart, ExportedVectors
from bcid.documents.report import ProcessNoiseFigures
from bcid.errors import InputRefused, Problems
from bcid.evaluation.validity import QUANTITIES
from bcid.export.check import Checked
from bcid.export.commands import steering_limit_of
from bcid.export.exported import Exported
from bcid.export.formats import FORMATS, Files
from bcid.export.formulas import CENTRE_OF_GRAVITY, Variable
from bcid.files.outputs import MayReplace, staged_outputs


def write_export(
    e: Exported, formats: Sequence[str], folder: Path, may_replace: MayReplace, progress: Progress
) -> ExportDocument:
    """Write an export in some `formats` into `folder`, with NAME.json; returns what that holds.

    A format that does not do what the model does is left out, with those that need it, and named in what is returned;
    where files of it lie in `folder` already, nothing is written, as they would lie beside those of another model.

    Raises:
        InputRefused: none of the formats does what the model does, or a file would be overwritten.
        DiskFull: the disk is full.
    """
    made, refused, left, chosen = list[ExportedFormat](), dict[str, InputRefused](), list[Path](), _with_needed(formats)
    with staged_outputs(folder, may_replace) as staged:
        for i, name in enumerate(chosen):
            progress(i / len(chosen), name)
            files = FORMATS[name].write(e)
            try:
                made.append(_write_format(e, name, files, staged, refused))
            except InputRefused as refusal:
                refused[name] = refusal
                left += [folder / file for file in files if (folder / file).exists()]
        if left or not made:
            Problems(p for refusal in refused.values() for p in refusal.problems).raise_if_any(folder)
        document = _describe(e, made, {name: str(refusal) for name, refusal in refused.items()})
        document.write(staged / f"{e.name}.json")
    return document


def _write_format(
    e: Exported, name: str, files: Files, folder: Path, refused: Mapping[str, InputRefused]
) -> ExportedFormat:  # fmt: skip
    """Write the `files` of one format into `folder` and check them.

    Raises:
        InputRefused: it does not do what the model does, and its files are removed; or it needs one of those `refused`.
    """
    for needed in FORMATS[name].needs:
        if needed in refused:
            raise refused[needed]
    try:
        for file, content in files.items():
            (folder / file).write_bytes(content.encode("utf-8") if isinstance(content, str) else content)
        check = FORMATS[name].check
        checked = check(folder, e) if check else Checked(None, "it holds no equations")
    except InputRefused:
        for file in files:
            (folder / file).unlink(missing_ok=True)
        raise
    return ExportedFormat(format=name, files=tuple(files), error=checked.error, not_checked=checked.not_checked)


def _with_needed(formats: Sequence[str]) -> list[str]:
    """The `formats` and those that they need, in the order of the table."""
    wanted = {needed for name in formats for needed in (name, *FORMATS[name].needs)}
    return [name for name in FORMATS if name in wanted]


def _describe(e: Exported, made: Sequence[ExportedFormat], refused: dict[str, str]) -> ExportDocument:
    """What NAME.json says of an export whose formats are `made`, and others `refused`."""
    noise = e.validity.noise if e.validity else None
    results = (*e.formulas.results, *e.formulas.first_states)
    parameters = [node for node in e.formulas.graph.nodes_for(results) if node.operation == "parameter"]
    return ExportDocument(
        kind="bcid.export/1", name=e.name, model=e.model.name, model_digest=e.digest, made_by=f"bcid {__version__}",
        of="vehicle" if e.without_measurement else "recording", time_s=e.time_s, point=e.point,
        period_s=e.formulas.period_s, states=_quantities(e, e.formulas.states), commands=_quantities(e, e.commands),
        twist=_quantities(e, e.twist), steering_limit_rad=steering_limit_of(e.model),
        constants={node.name: float(node.value or 0.0) for node in parameters},
        process_noise=noise and ProcessNoiseFigures(**noise._asdict()), formats=tuple(made), refused=refused,
        vectors=_vectors(e),
    )  # fmt: skip


def _quantities(e: Exported, quantities: Sequence[Variable]) -> tuple[ExportedQuantity, ...]:
    """Quantities with their range over the data that the model was fitted on, where it is known.

    It is known of the point that was tracked, whose velocities are not those of a centre of gravity elsewhere.
    """
    names = list(QUANTITIES)
    ranges = dict[str, tuple[float, float]]()
    if e.validity:
        ranges = {n: (low, high) for n, low, high in zip(names, *e.validity.range, strict=True)}
    if e.measured_otherwise and any(CENTRE_OF_GRAVITY in q.meaning for q in quantities):
        ranges = {n: limits for n, limits in ranges.items() if n not in ("v_x", "v_y")}
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
