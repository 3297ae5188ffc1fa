"""TOML files read into checked, immutable settings: all problems of one file are told together."""

from __future__ import annotations

import difflib
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ConfigDict, ValidationError

from bcid.errors import InputRefused


class Settings(BaseModel):
    """A table of a TOML file: immutable, unknown keys refused, numbers finite."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False, populate_by_name=True)


MAX_BYTES = 1 << 20

S = TypeVar("S", bound=Settings)


def read_toml(path: Path, kind: type[S], what: str, example: str = "`bcid init` writes a commented one") -> S:
    """The file at `path` as a `kind`; errors point to the `example`.

    Raises:
        InputRefused: not found, not TOML, or with unknown, missing or impossible entries.
    """
    if path.exists() and not path.is_file():  # a pipe would be waited for
        raise InputRefused(path, what, "is not a regular file", f"check the path; {example}")
    if path.exists() and path.stat().st_size > MAX_BYTES:
        raise InputRefused(path, what, f"has {path.stat().st_size} bytes, {MAX_BYTES} are the most", example)
    try:
        text = path.read_text(encoding="utf-8-sig")
        data = tomllib.loads(text)
    except (OSError, UnicodeDecodeError) as error:
        raise InputRefused(path, what, f"cannot be read: {error}", f"check the path; {example}") from None
    except RecursionError:
        raise InputRefused(path, what, "is nested too deeply", f"see how it should look; {example}") from None
    except tomllib.TOMLDecodeError as error:
        raise InputRefused(path, what, f"not valid TOML: {error}", "mend the line named above") from None
    return validated(path, kind, data, what, example)


def validated(path: Path, kind: type[S], data: Mapping[str, Any], what: str, example: str) -> S:
    """What the file at `path` says, as a `kind`.

    Raises:
        InputRefused: with all of its entries that are unknown, missing or impossible.
    """
    try:
        return kind.model_validate(data)
    except ValidationError as error:
        problems = [_problem(dict(e), kind) for e in error.errors()]
        places = ", ".join(place for place, _ in problems)
        raise InputRefused(
            path,
            places,
            "; ".join(text for _, text in problems),
            f"correct the {what}; {example}",
        ) from None


def _problem(error: dict[str, Any], kind: type[BaseModel]) -> tuple[str, str]:
    place = ".".join(str(part) for part in error["loc"])
    if error["type"] != "extra_forbidden":
        return place, f"{place}: {error['msg']}"
    known = _keys_beside(kind, error["loc"])
    near = difflib.get_close_matches(str(error["loc"][-1]), known, n=1)
    hint = f" (did you mean {near[0]}?)" if near else f" (known here: {', '.join(known)})"
    return place, f"unknown key {place}{hint}"


def _keys_beside(kind: type[BaseModel], loc: tuple[Any, ...]) -> list[str]:
    for part in loc[:-1]:
        field = next((f for n, f in kind.model_fields.items() if str(part) in (n, f.alias)), None)
        inner = [] if field is None else [field.annotation, *getattr(field.annotation, "__args__", ())]
        nested = [t for t in map(_bare, inner) if isinstance(t, type) and issubclass(t, BaseModel)]
        if not nested:
            return []
        kind = nested[0]
    return sorted(f.alias or name for name, f in kind.model_fields.items())


def _bare(annotation: Any) -> Any:
    """The type inside an `Annotated`."""
    return getattr(annotation, "__origin__", annotation) if hasattr(annotation, "__metadata__") else annotation
