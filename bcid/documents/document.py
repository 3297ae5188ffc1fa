"""What all documents have in common: immutable, typed, NaN as null, read back by the definition that wrote them."""

import difflib
import json
import math
from pathlib import Path
from typing import Annotated, Any, Self

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, PlainSerializer, ValidationError, model_validator
from pydantic_core import InitErrorDetails

from bcid.errors import InputRefused
from bcid.files.limits import LIMITS
from bcid.files.regular import read_regular_file

SHOWN_PROBLEMS = 8
"""Wrong fields that a message names; of an array of a million there may be as many."""
MAX_WHOLE_BITS = 256
"""Bits of the largest whole number in a document: a SHA-256 has as many, and may serve as a seed."""
SHOWN_LENGTH = 40
"""Characters of a wrong value that a message shows."""


def _is_beyond_numbers(value: object) -> bool:
    """Whether `value`, or anything in the lists and dicts that it is made of, is a whole number of too many bits."""
    if isinstance(value, list | tuple | dict):
        return any(map(_is_beyond_numbers, value.values() if isinstance(value, dict) else value))
    return isinstance(value, int) and value.bit_length() > MAX_WHOLE_BITS


class Part(BaseModel):
    """A part of a document: immutable; unknown fields, which a later version may write, are passed over."""

    model_config = ConfigDict(frozen=True, extra="ignore", populate_by_name=True, allow_inf_nan=False)

    @model_validator(mode="after")
    def _check_whole_numbers(self) -> Self:
        """Refuse whole numbers that are more than any count, seed or digest, and that nothing can compute with."""
        for name, value in self:
            if _is_beyond_numbers(value):
                raise ValueError(f"{name} holds a whole number of more than {MAX_WHOLE_BITS} bits")
        return self

    def as_json(self) -> dict[str, Any]:
        """The part as JSON holds it, under its published keys."""
        return self.model_dump(by_alias=True)


def _null_for_nan(value: object) -> object:
    """`value`, but None (null in JSON) in place of a float that is NaN or infinite."""
    return None if isinstance(value, float) and not math.isfinite(value) else value


NotNegative = Annotated[float, Field(ge=0.0)]
"""A figure that is there, finite, and zero or more."""

Number = Annotated[float | None, BeforeValidator(_null_for_nan)]
"""A figure that may be missing: what is not a finite number is null."""


def _nan_for_null(value: object) -> object:
    """`value`, but NaN in place of None (null in JSON)."""
    return math.nan if value is None else value


Figure = Annotated[
    float, Field(allow_inf_nan=True), BeforeValidator(_nan_for_null), PlainSerializer(_null_for_nan, float | None)
]
"""A figure that is always there: NaN in memory is null in JSON, either way."""

Interval = tuple[Figure, Figure]
"""The low and the high end of an interval."""


def describe_problems(error: ValidationError, kind: type[BaseModel]) -> tuple[str, str]:
    """Places and causes, as text, of all that is wrong with a document of the class `kind`, by pydantic's `error`.

    No more than SHOWN_PROBLEMS are named; a key that is not known comes with the known one that is most like it.
    """
    errors = error.errors(include_url=False)
    named = [(".".join(map(str, e["loc"])) or "document", _describe_cause(dict(e), kind)) for e in errors]
    if len(named) == 1:
        return named[0]
    places = ", ".join(dict.fromkeys(place for place, _ in named[:SHOWN_PROBLEMS]))
    causes = "; ".join(f"{place}: {cause}" for place, cause in named[:SHOWN_PROBLEMS])
    more = len(named) - SHOWN_PROBLEMS
    return places, causes + (f"; and {more} more" if more > 0 else "")


def _describe_cause(error: dict[str, Any], kind: type[BaseModel]) -> str:
    """What is wrong with one field of a document of the class `kind`, by one of pydantic's errors."""
    if error["type"] == "missing":
        return "is missing"
    if error["type"] == "extra_forbidden":
        for key in error["loc"][:-1]:
            field = kind.model_fields.get(str(key))
            if field is None or not (isinstance(field.annotation, type) and issubclass(field.annotation, BaseModel)):
                return "there is no such key"
            kind = field.annotation
        near = difflib.get_close_matches(str(error["loc"][-1]), kind.model_fields, n=3)
        return "there is no such key" + (f", perhaps {', '.join(near)}" if near else "")
    cause = str(error["msg"]).removeprefix("Value error, ").replace("Input should", "should")
    shown = repr(error["input"])
    return cause if error["type"] == "json_invalid" else f"{cause}, not {shown[:SHOWN_LENGTH]}"


class Document(Part):
    """A whole document; the `schema` key of one that leaves the workspace names its kind and version."""

    def write(self, path: Path) -> None:
        """Write the document to `path` as indented JSON."""
        path.write_text(json.dumps(self.as_json(), indent=1, ensure_ascii=False, allow_nan=False), encoding="utf-8")

    @classmethod
    def from_json(cls, text: str | bytes) -> Self:
        """Parse a document: no type is converted, and its schema key, where it has one, must be there.

        Raises:
            ValidationError: `text` is not JSON, or is no such document.
        """
        document = cls.model_validate_json(text, strict=True)
        if "kind" in cls.model_fields and "kind" not in document.model_fields_set:
            missing = InitErrorDetails(type="missing", loc=("schema",), input=None)
            raise ValidationError.from_exception_data(cls.__name__, [missing])
        return document

    @classmethod
    def read(cls, path: Path) -> Self:
        """Read the document at `path`.

        Raises:
            InputRefused: it cannot be read, is not JSON, or is no such document; with every field that is wrong.
        """
        try:
            return cls.from_json(read_regular_file(path, LIMITS.max_json_bytes))
        except ValidationError as error:
            raise InputRefused(path, *describe_problems(error, cls), "make the file again") from None
        except OSError as error:
            raise InputRefused(path, "document", f"cannot be read: {error.strerror}", "check the path") from None
        except ValueError as error:
            raise InputRefused(path, "document", str(error), "check the path") from None
