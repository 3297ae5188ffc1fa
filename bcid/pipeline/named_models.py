"""Saved models by name: `bcid fit` puts a copy of each at WORKSPACE/models/NAME, a diagnosis its own beside them."""

from collections.abc import Callable
from pathlib import Path

from bcid.errors import InputRefused

MODELS_FOLDER = "models"
DIAGNOSED = "diagnosis"
"""The name of the model that `bcid diagnose` made: the car with what was found."""
WITH_REMAINDER = "with_remainder"
"""The name of that car with what has no name, which is there where something is left beside the names."""
MODEL_FILES = ("model.json", "arrays.safetensors", "limits.json", "takes.json", "residuals.json", "description.txt")
"""All files that may lie in the folder of a saved model."""


def name_of_fit(model: str, loss: str | None, usual_loss: str | None) -> str:
    """The name under which a fit is saved: the model's, with its loss where that is not the pipeline file's.

    >>> name_of_fit("newton-euler", "poses", "rollout"), name_of_fit("k-sindy", None, "rollout")
    ('newton-euler-poses', 'k-sindy')
    """
    return model if loss is None or loss == usual_loss else f"{model}-{loss}"


def saved_models(workspace: Path) -> dict[str, Path]:
    """Folders of the saved models in a workspace, or in the results of a diagnosis of named recordings, by name."""
    found = {path.parent.name: path.parent for path in sorted(workspace.glob(f"{MODELS_FOLDER}/*/{MODEL_FILES[0]}"))}
    for home in (workspace / DIAGNOSED, workspace):
        for name, folder in ((DIAGNOSED, home / "model"), (WITH_REMAINDER, home / WITH_REMAINDER)):
            if (folder / MODEL_FILES[0]).is_file():
                found.setdefault(name, folder)
    return found


def find_model(named: str, workspace: Callable[[], Path | None]) -> Path:
    """The folder of the saved model that a person calls `named`: a path of such a folder, or a name in `workspace()`.

    The workspace, which may take a pipeline file to know, is asked for only where no such folder exists.

    Raises:
        InputRefused: there is neither; the message lists the names that there are.
    """
    path = Path(named)
    if (path / MODEL_FILES[0]).exists():
        return path
    home = workspace()
    known = {} if home is None else saved_models(home)
    if named in known:
        return known[named]
    if path.exists():
        inside = ", ".join(map(str, saved_models(path).values())) if path.is_dir() else ""
        raise InputRefused(path, "model.json", "holds no fitted model", f"name one of {inside or 'fitted models'}")
    if home is None:
        cause = "is no folder of a saved model, and no pipeline file says in which workspace such a name is kept"
        raise InputRefused(named, "model", cause, "name the model's folder, or the pipeline file with -p")
    if not known:
        cause = f"there is no fitted model there, and none in {home} either"
        raise InputRefused(named, "model", cause, "fit one with `bcid fit`")
    cause = f"is neither a folder of a saved model nor the name of one in {home}"
    raise InputRefused(named, "model", cause, f"choose one of {', '.join(known)}, or fit it with `bcid fit`")
