"""Fitted models on disk: model.json and, where there are arrays, arrays.safetensors.  No pickle."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from bcid.errors import InputRefused
from bcid.files.json import read_json, write_json
from bcid.models.interface import Model
from bcid.models.table import MODELS
from bcid.store.artifact import sha256_of

SCHEMA = "bcid.model/1"
ARRAYS_DIGEST = "arrays_sha256"
MAX_ARRAYS = 1 << 28  # bytes
FILES = _JSON, _ARRAYS = "model.json", "arrays.safetensors"


def save_model(model: Model, folder: Path) -> None:
    """Write `model` into `folder`."""
    data, arrays = model.state()
    digest = {}
    if arrays:
        from safetensors.numpy import save_file

        save_file(arrays, folder / _ARRAYS)
        digest = {ARRAYS_DIGEST: sha256_of(folder / _ARRAYS)}
    write_json(folder / _JSON, {"schema": SCHEMA, "model": model.name, **data, **digest})


def _arrays(path: Path, stated: str | None) -> dict[str, Any]:
    from safetensors.numpy import load_file

    if not path.exists():
        if stated is not None:
            raise ValueError(f"{path.name} is missing")
        return {}
    if path.stat().st_size > MAX_ARRAYS:
        raise ValueError(f"{path.name} has {path.stat().st_size} bytes, {MAX_ARRAYS} are the most")
    if stated is not None and sha256_of(path) != stated:
        raise ValueError(f"{path.name} is not as it was saved: its digest differs")
    return load_file(path)


def load_model(folder: Path) -> Model:
    """The model saved in `folder`, whose digests are checked.

    Raises:
        InputRefused: no model there, one of another version, or one that holds what it must not.
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
        arrays = _arrays(folder / _ARRAYS, data.pop(ARRAYS_DIGEST, None))
        return MODELS[name].load().from_state(data, arrays)
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError, SafetensorError) as error:
        cause = f"cannot be read as {name}: {error if isinstance(error, ValueError) else repr(error)}"
        raise InputRefused(folder, _JSON, cause, "fit or diagnose again") from None
