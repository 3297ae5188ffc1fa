"""Fitted models on disk: model.json and, where there are arrays, arrays.safetensors.  No pickle."""

import hashlib
from pathlib import Path
from typing import Any

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


def save_model(model: Model, folder: Path) -> None:
    """Write `model` into `folder`: model.json and, if it has arrays, arrays.safetensors (its SHA-256 in model.json)."""
    data, arrays = model.to_saved()
    data = {"schema": SCHEMA, "model": model.name, **data}
    if arrays:
        from safetensors.numpy import save_file

        save_file(arrays, folder / _ARRAYS)
        data[ARRAYS_DIGEST] = file_sha256(folder / _ARRAYS)
    write_json(folder / _JSON, data)


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
        InputRefused: there is no model, it is damaged or of another version, or its numbers make no such model.
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
    try:
        arrays = _read_arrays(folder / _ARRAYS, data.pop(ARRAYS_DIGEST, None))
        return MODELS[name].load_class().from_saved(data, arrays)
    except ValueError as error:
        raise InputRefused(folder, _JSON, f"cannot be read as {name}: {error}", "fit or diagnose again") from None
