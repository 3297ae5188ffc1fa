"""Fitted models on disk: model.json and, where there are arrays, arrays.safetensors.  No pickle."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from bcid.errors import InputRefused
from bcid.models.interface import Model
from bcid.models.table import MODELS

SCHEMA = "bcid.model/1"
FILES = _JSON, _ARRAYS = "model.json", "arrays.safetensors"


def save_model(model: Model, folder: Path) -> None:
    """Write `model` into `folder`."""
    data, arrays = model.state()
    text = json.dumps({"schema": SCHEMA, "model": model.name, **data}, indent=1, ensure_ascii=False)
    (folder / _JSON).write_text(text, encoding="utf-8")
    if arrays:
        from safetensors.numpy import save_file

        save_file(arrays, folder / _ARRAYS)


def load_model(folder: Path) -> Model:
    """The model saved in `folder`.

    Raises:
        InputRefused: no model there, one of another version, or one that holds what it must not.
    """
    try:
        data: dict[str, Any] = json.loads((folder / _JSON).read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise InputRefused(folder, _JSON, f"holds no fitted model: {error}", "fit one with `bcid fit`") from None
    schema, name = (data.get("schema"), str(data.get("model"))) if isinstance(data, dict) else (None, "")
    if schema != SCHEMA or name not in MODELS:
        raise InputRefused(folder, _JSON, f"is {schema!r} of {name!r}, not {SCHEMA}", "fit the model again")
    from safetensors import SafetensorError
    from safetensors.numpy import load_file

    try:
        arrays = load_file(folder / _ARRAYS) if (folder / _ARRAYS).exists() else {}
        return MODELS[name].load().from_state(data, arrays)
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError, SafetensorError) as error:
        cause = f"cannot be read as {name}: {error if isinstance(error, ValueError) else repr(error)}"
        raise InputRefused(folder, _JSON, cause, "fit or diagnose again") from None
