"""Fitted models on disk: model.json and, where there are arrays, arrays.safetensors.  No pickle.

Beside a model with effects of a user's own lies a copy of the file that declares them, for people: it is never run from
there.  Such a model is read only while that very file is in use, since a user named it (`bcid.effects.own_file`).
"""

import hashlib
from pathlib import Path
from typing import Any

from bcid.effects.own_file import OwnFile, file_of_effects
from bcid.errors import InputRefused
from bcid.files.json import read_json, write_json
from bcid.files.regular import read_regular_file
from bcid.models.interface import Model
from bcid.models.limits import LIMITS
from bcid.models.table import MODELS
from bcid.store.artifact import file_sha256

SCHEMA = "bcid.model/1"
ARRAYS_DIGEST = "arrays_sha256"
FILES = _JSON, _ARRAYS = "model.json", "arrays.safetensors"
OWN_EFFECTS, OWN_DIGEST = "own_effects.py", "own_effects_sha256"


def save_model(model: Model, folder: Path) -> None:
    """Write `model` into `folder`: model.json and, if it has arrays, arrays.safetensors (its SHA-256 in model.json).

    A copy of the user's file is written, too, if the model has effects of it.
    """
    data, arrays = model.to_saved()
    data = {"schema": SCHEMA, "model": model.name, **data}
    if arrays:
        from safetensors.numpy import save_file

        save_file(arrays, folder / _ARRAYS)
        data[ARRAYS_DIGEST] = file_sha256(folder / _ARRAYS)
    if own := _own_file_of(data):
        (folder / OWN_EFFECTS).write_bytes(own.text.encode())
        data[OWN_DIGEST] = own.sha256
    write_json(folder / _JSON, data)


def _own_file_of(data: dict[str, Any]) -> OwnFile | None:
    """The user's file in use that declares effects of a model with these data; None where it has no such effects."""
    effects = data.get("effects")
    return file_of_effects(effects) if isinstance(effects, dict) else None


def _require_own_effects(folder: Path, data: dict[str, Any], digest: object) -> None:
    """Raise `InputRefused` unless the user's file with this SHA-256 is in use; without one, no effect may be of any."""
    own = _own_file_of(data)
    if digest == (own and own.sha256):
        return
    copy = folder / OWN_EFFECTS
    if own is None:
        cause = f"has effects of a user's own, in {copy} as they were; nothing runs them unasked"
        raise InputRefused(folder, _JSON, cause, f"read that file; if you trust it, name it: --effects {copy}")
    cause = f"has effects of another file than {own.name}, whose SHA-256 is {own.sha256[:12]}…"
    raise InputRefused(folder, _JSON, cause, f"name the file with which it was made; a copy of it is {copy}")


def has_own_effects(folder: Path) -> bool:
    """Whether the model saved in `folder` says that it has effects of a user's own; False where there is no model."""
    try:
        return OWN_DIGEST in read_json(folder / _JSON)
    # whoever loads the model says what is wrong with the file
    except (OSError, ValueError):
        return False


def model_digest(folder: Path) -> str:
    """The SHA-256 of the model saved in `folder`, which holds that of its arrays, in hex digits."""
    return file_sha256(folder / _JSON)


def _read_arrays(path: Path, expected_digest: object) -> dict[str, Any]:
    """Read the arrays by name from the safetensors file at `path`; none if there is neither file nor expected digest.

    Raises:
        ValueError: the file is missing, broken, no regular file of at most LIMITS.max_array_bytes, or its SHA-256 is
            not `expected_digest`.
    """
    from safetensors.numpy import load

    if not path.exists():
        if expected_digest is not None:
            raise ValueError(f"{path.name} is missing")
        return {}
    try:
        content = read_regular_file(path, LIMITS.max_array_bytes)
    except (OSError, ValueError) as error:
        raise ValueError(f"{path.name} {error}") from None
    if expected_digest is not None and hashlib.sha256(content).hexdigest() != expected_digest:
        raise ValueError(f"{path.name} is not as it was saved: its digest differs")
    try:
        return load(content)
    # whatever the library raises, the file is at fault: types that numpy lacks, shapes that overflow
    except Exception as error:
        raise ValueError(f"{path.name} is no safetensors file: {error!r}") from None


def load_model(folder: Path) -> Model:
    """The fitted model that `save_model` wrote into `folder`, after the SHA-256 of its arrays is checked.

    Raises:
        InputRefused: there is no model, it is damaged or of another version, its numbers make no such model, or it has
            effects of a user's own whose file is not in use.
    """
    try:
        data = read_json(folder / _JSON)
    except OSError as error:
        raise InputRefused(folder, _JSON, f"holds no fitted model: {error}", "fit one with `bcid fit`") from None
    except ValueError as error:
        raise InputRefused(folder, _JSON, f"is damaged: {error}", "fit the model again") from None
    schema, name = data.pop("schema", None), data.pop("model", None)
    if schema != SCHEMA or not isinstance(name, str) or name not in MODELS:
        cause = f"is {schema!r:.60} of {name!r:.60}, not {SCHEMA} of one of {', '.join(MODELS)}"
        raise InputRefused(folder, _JSON, cause, "fit the model again")
    _require_own_effects(folder, data, data.pop(OWN_DIGEST, None))
    try:
        arrays = _read_arrays(folder / _ARRAYS, data.pop(ARRAYS_DIGEST, None))
        return MODELS[name].load_class().from_saved(data, arrays)
    except ValueError as error:
        raise InputRefused(folder, _JSON, f"cannot be read as {name}: {error}", "fit or diagnose again") from None
