"""Words that the shell completes: names of models, effects, losses, formats; what knows them is imported only then."""

import os
import re
from contextlib import suppress
from pathlib import Path

from bcid.cli.options import workspace_of


def complete_saved_models(incomplete: str) -> list[str]:
    """Names of the saved models in the workspace of the folder's pipeline file, for the shell, and paths."""
    names: list[str] = []
    with suppress(Exception):  # a shell that completes a word shows no errors
        from bcid.pipeline.named_models import saved_models

        workspace = workspace_of(None)
        names = list(saved_models(workspace)) if workspace else []
    return [n for n in names if n.startswith(incomplete)] or _complete_paths(incomplete)


def complete_fittable_models(incomplete: str) -> list[str]:
    """Names of the models that can be fitted, for the shell."""
    from bcid.models.table import FITTABLE

    return [name for name in FITTABLE if name.startswith(incomplete)]


def complete_compared_models(incomplete: str) -> list[str]:
    """Names of the models that can be fitted or have been saved, for the shell, and paths."""
    return list(dict.fromkeys([*complete_fittable_models(incomplete), *complete_saved_models(incomplete)]))


def complete_effects(incomplete: str) -> list[str]:
    """Ids of effects, for the shell."""
    from bcid.effects.table import EFFECTS

    return [name for name in EFFECTS if name.startswith(incomplete)]


def complete_export_formats(incomplete: str) -> list[str]:
    """Formats of code that models are exported as, for the shell."""
    from bcid.export.formats import FORMATS

    return [name for name in (*FORMATS, "all") if name.startswith(incomplete)]


def complete_losses(incomplete: str) -> list[str]:
    """What a fit may minimise, for the shell."""
    from bcid.models.settings import LOSSES

    return [name for name in LOSSES if name.startswith(incomplete)]


def _complete_paths(incomplete: str) -> list[str]:
    """Paths of files and folders that begin with `incomplete`; folders end with a separator."""
    begin = re.split(r"[/\\]" if os.altsep else "/", incomplete)[-1]
    folder = incomplete[: len(incomplete) - len(begin)]
    parent = Path(folder or ".")
    with suppress(OSError):
        inside = sorted(p for p in parent.iterdir() if p.name.startswith(begin) and (begin or p.name[0] != "."))
        return [f"{folder}{p.name}{os.sep * p.is_dir()}" for p in inside]
    return []
