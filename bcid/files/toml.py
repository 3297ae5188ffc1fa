"""TOML files read into checked, immutable settings: all problems of one file are reported together."""

import difflib
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from bcid.errors import InputRefused
from bcid.files.limits import LIMITS


class Settings(BaseModel):
    """A table of a TOML file: immutable, unknown keys refused, numbers finite."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False, populate_by_name=True)


PathText = Annotated[Path, Field(strict=False)]
"""Type of a field that holds a path, which a TOML file writes as text."""

S = TypeVar("S", bound=Settings)


def read_toml(path: Path, kind: type[S], what: str, example: str = "`bcid init` writes a commented one") -> S:
    """The TOML file at `path`, checked and read into settings of the class `kind`.

    Error messages call the file `what`, such as "vehicle file", and say by `example` where a correct one is found.

    Raises:
        InputRefused: not found, too large, not TOML, or with unknown, missing or impossible entries.
    """
    if path.exists() and not path.is_file():  # a pipe would be waited for
        raise InputRefused(path, what, "is not a regular file", f"check the path; {example}")
    if path.exists() and (size := path.stat().st_size) > LIMITS.max_toml_bytes:
        raise InputRefused(path, what, f"has {size} bytes, {LIMITS.max_toml_bytes} are the most", example)
    try:
        data = tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except (OSError, UnicodeDecodeError) as error:
        raise InputRefused(path, what, f"cannot be read: {error}", f"check the path; {example}") from None
    except RecursionError:
        raise InputRefused(path, what, "is nested too deeply", f"see how it should look; {example}") from None
    except tomllib.TOMLDecodeError as error:
        raise InputRefused(path, what, f"not valid TOML: {error}", "mend the line named above") from None
    return validate_settings(path, kind, data, what, example)


def validate_settings(path: Path, kind: type[S], data: Mapping[str, Any], what: str, example: str) -> S:
    """Settings of the class `kind` from the tables `data` that were read from `path`.

    Error messages call the file `what` and say by `example` where a correct one is found.

    Raises:
        InputRefused: there are wrong entries; the message names all of them.
    """
    try:
        return kind.model_validate(data)
    except ValidationError as error:
        problems = [_describe_problem(dict(e), kind) for e in error.errors()]
        places, causes = ", ".join(place for place, _ in problems), "; ".join(text for _, text in problems)
        raise InputRefused(path, places, causes, f"correct the {what}; {example}") from None


def _describe_problem(error: dict[str, Any], kind: type[BaseModel]) -> tuple[str, str]:
    """Place and cause, as text, of one of pydantic's errors on settings of `kind`; unknown keys get a suggestion."""
    place = ".".join(str(part) for part in error["loc"])
    if error["type"] != "extra_forbidden":
        return place, f"{place}: {error['msg']}"
    known = _known_keys(kind, error["loc"])
    near = difflib.get_close_matches(str(error["loc"][-1]), known, n=1)
    hint = f" (did you mean {near[0]}?)" if near else f" (known here: {', '.join(known)})"
    return place, f"unknown key {place}{hint}"


def _known_keys(kind: type[BaseModel], loc: tuple[Any, ...]) -> list[str]:
    """Names of the keys that settings of the class `kind` allow in the table that holds the entry at the path `loc`."""
    for part in loc[:-1]:
        field = next((f for n, f in kind.model_fields.items() if str(part) in (n, f.alias)), None)
        inner = [] if field is None else [field.annotation, *getattr(field.annotation, "__args__", ())]
        # the type inside an `Annotated`
        inner = [getattr(t, "__origin__", t) if hasattr(t, "__metadata__") else t for t in inner]
        nested = [t for t in inner if isinstance(t, type) and issubclass(t, BaseModel)]
        if not nested:
            return []
        kind = nested[0]
    return sorted(f.alias or name for name, f in kind.model_fields.items())
