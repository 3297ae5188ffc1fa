"""What all documents have in common: immutable, typed, NaN as null, read back by the definition that wrote them."""

import json
import math
from pathlib import Path
from typing import Annotated, Any, Self

from pydantic import BaseModel, BeforeValidator, ConfigDict, ValidationError, model_validator

from bcid.errors import InputRefused


class Part(BaseModel):
    """A part of a document: immutable; unknown fields, which a later version may write, are passed over."""

    model_config = ConfigDict(frozen=True, extra="ignore", populate_by_name=True, allow_inf_nan=False)

    @model_validator(mode="before")
    @classmethod
    def _pass_over_nulls(cls, data: Any) -> Any:
        """What is null was not told: the field has its default, or is missing."""
        return {k: v for k, v in data.items() if v is not None} if isinstance(data, dict) else data

    def as_json(self) -> dict[str, Any]:
        """The part as JSON holds it, under its published keys."""
        return self.model_dump(by_alias=True)


def _null_for_nan(value: object) -> object:
    """Replace a number that is not finite by null."""
    return None if isinstance(value, float) and not math.isfinite(value) else value


Number = Annotated[float | None, BeforeValidator(_null_for_nan)]
"""A figure that may be missing: what is not a finite number is null."""

Interval = tuple[float, float]
"""The low and the high end of an interval."""


class Document(Part):
    """A whole document; its `schema` key, defined by each, names its kind and version."""

    def write(self, path: Path) -> None:
        """Write the document to `path` as indented JSON."""
        path.write_text(json.dumps(self.as_json(), indent=1, ensure_ascii=False, allow_nan=False), encoding="utf-8")

    @classmethod
    def read(cls, path: Path) -> Self:
        """Read the document at `path`.

        Raises:
            InputRefused: it cannot be read, is not JSON, or is no such document; with every field that is wrong.
        """
        try:
            return cls.model_validate_json(path.read_bytes())
        except OSError as error:
            raise InputRefused(path, "document", f"cannot be read: {error.strerror}", "check the path") from None
        except ValidationError as error:
            places = ", ".join(".".join(map(str, e["loc"])) or "document" for e in error.errors())
            causes = "; ".join(e["msg"] for e in error.errors())
            raise InputRefused(path, places, causes, "make the file again") from None
