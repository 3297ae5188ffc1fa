"""`bcid init`: a vehicle file and a pipeline file to start from."""

from pathlib import Path
from typing import Annotated

import typer

from bcid.cli import options
from bcid.cli.options import Format

OTHER_FOLDER = "name another folder"


def init(
    folder: Annotated[Path, typer.Argument(help="The folder to write the two files to.")] = Path(),
    force: options.ForceOption = False,
    format: options.FormatOption = Format.human,  # noqa: A002
) -> None:
    """Write a commented vehicle file and pipeline file to start from."""
    from bcid.cli.sink import Sink
    from bcid.files.outputs import staged_outputs

    templates = sorted((Path(__file__).parent / "templates").glob("*.toml"))
    with staged_outputs(folder, lambda path: force, OTHER_FOLDER) as staged:
        for template in templates:
            (staged / template.name).write_bytes(template.read_bytes())
    targets = [str(folder / template.name) for template in templates]
    Sink(format).result(
        {"schema": "bcid.init/1", "files": targets},
        lambda: "\n".join([*targets, _next_step(folder)]),
    )


def _next_step(folder: Path) -> str:
    """What to type once the two files in `folder` are filled in; a pipeline file beside which one stands is found."""
    where = "" if folder == Path() else f" -p {folder / 'pipeline.toml'}"
    return f"next: edit both, then bcid run{where}"
