"""Fitted models on disk: model.json and, where there are arrays, arrays.safetensors.  No pickle."""

from pathlib import Path
from typing import Any

from bcid.errors import InputRefused
from bcid.files.json import read_json, write_json
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


def _read_arrays(path: Path, expected_digest: str | None) -> dict[str, Any]:
    """Read the arrays by name from the safetensors file at `path`; none if there is neither file nor expected digest.

    Raises:
        ValueError: the file is missing, larger than LIMITS.max_array_bytes, or its SHA-256 is not `expected_digest`.
    """
    from safetensors.numpy import load_file

    if not path.exists():
        if expected_digest is not None:
            raise ValueError(f"{path.name} is missing")
        return {}
    if path.stat().st_size > LIMITS.max_array_bytes:
        raise ValueError(f"{path.name} has {path.stat().st_size} bytes, {LIMITS.max_array_bytes} are the most")
    if expected_digest is not None and file_sha256(path) != expected_digest:
        raise ValueError(f"{path.name} is not as it was saved: its digest differs")
    return load_file(path)


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
    schema, name = data.get("schema"), str(data.get("model"))
    if schema != SCHEMA or name not in MODELS:
        raise InputRefused(folder, _JSON, f"is {schema!r} of {name!r}, not {SCHEMA}", "fit the model again")
    from safetensors import SafetensorError

    try:
        arrays = _read_arrays(folder / _ARRAYS, data.pop(ARRAYS_DIGEST, None))
        return MODELS[name].load_class().from_saved(data, arrays)
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError, SafetensorError) as error:
        cause = f"cannot be read as {name}: {error if isinstance(error, ValueError) else repr(error)}"
        raise InputRefused(folder, _JSON, cause, "fit or diagnose again") from None
