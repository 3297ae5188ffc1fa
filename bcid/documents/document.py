"""What all documents have in common: immutable, typed, NaN as null, read back by the definition that wrote them."""

import json
import math
from pathlib import Path
from typing import Annotated, Any, Self

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, PlainSerializer, ValidationError
from pydantic_core import InitErrorDetails

from bcid.errors import InputRefused


class Part(BaseModel):
    """A part of a document: immutable; unknown fields, which a later version may write, are passed over."""

    model_config = ConfigDict(frozen=True, extra="ignore", populate_by_name=True, allow_inf_nan=False)

    def as_json(self) -> dict[str, Any]:
        """The part as JSON holds it, under its published keys."""
        return self.model_dump(by_alias=True)


def _null_for_nan(value: object) -> object:
    """`value`, but None (null in JSON) in place of a float that is NaN or infinite."""
    return None if isinstance(value, float) and not math.isfinite(value) else value


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
            return cls.from_json(path.read_bytes())
        except OSError as error:
            raise InputRefused(path, "document", f"cannot be read: {error.strerror}", "check the path") from None
        except ValidationError as error:
            places = ", ".join(".".join(map(str, e["loc"])) or "document" for e in error.errors())
            causes = "; ".join(e["msg"] for e in error.errors())
            raise InputRefused(path, places, causes, "make the file again") from None
