"""TOML files read into checked, immutable settings: all problems of one file are reported together."""

import difflib
import io
import os
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, TypeVar

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError

from bcid.errors import InputRefused, shorten
from bcid.files.limits import LIMITS
from bcid.files.regular import read_regular_file


class Settings(BaseModel):
    """A table of a TOML file: immutable, unknown keys refused, numbers finite."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False, populate_by_name=True)


def _check_path_text(path: Path) -> Path:
    """Return `path`; raise `ValueError` where no file system can hold such a name: null characters, or too long."""
    if "\0" in str(path):
        raise ValueError("a path holds no null character")
    longest = max((len(os.fsencode(part)) for part in path.parts), default=0)
    if longest > LIMITS.max_name_bytes or len(os.fsencode(path)) > LIMITS.max_path_bytes:
        raise ValueError(f"a name in a path has at most {LIMITS.max_name_bytes} bytes, this has {longest}")
    return path


PathText = Annotated[Path, Field(strict=False), AfterValidator(_check_path_text)]
"""Type of a field that holds a path, which a TOML file writes as text."""

BACKSLASHES = r"write paths with /, or on Windows in single quotes: in double quotes \t is a tab and no folder's t"
"""What to do about a path whose backslashes were read as escapes."""

SHOWN_KEY_LENGTH = 80  # characters of a key in a message

S = TypeVar("S", bound=Settings)


def read_toml(path: Path, kind: type[S], what: str, example: str = "`bcid init` writes a commented one") -> S:
    """The TOML file at `path`, checked and read into settings of the class `kind`.

    Error messages call the file `what`, such as "vehicle file", and say by `example` where a correct one is found.

    Raises:
        InputRefused: not found, too large, not TOML, or with unknown, missing or impossible entries.
    """
    try:
        content = read_regular_file(path, LIMITS.max_toml_bytes)
    except (OSError, ValueError) as error:
        raise InputRefused(path, what, f"cannot be read: {error}", f"check the path; {example}") from None
    try:
        # lines end by "\n", "\r\n" or, from old editors, "\r" alone
        data = tomllib.loads(io.StringIO(content.decode("utf-8-sig"), newline=None).read())
    except UnicodeDecodeError as error:
        raise InputRefused(path, what, f"cannot be read: {error}", f"save it as UTF-8; {example}") from None
    except RecursionError:
        raise InputRefused(path, what, "is nested too deeply", f"see how it should look; {example}") from None
    except ValueError as error:  # beside what is no TOML, a number of thousands of digits
        escaped = "Unescaped" in str(error) or "Invalid hex" in str(error)
        next_step = BACKSLASHES if escaped else "mend the line named above"
        raise InputRefused(path, what, f"not valid TOML: {error}", next_step) from None
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
    place = ".".join(shorten(str(part), SHOWN_KEY_LENGTH) for part in error["loc"])
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
