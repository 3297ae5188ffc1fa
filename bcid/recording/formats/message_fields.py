"""Fields of decoded messages, be they of JSON, ROS 2 or protobuf, by paths such as `poses[name=car].pose.position.x`.

A path leads through fields (`pose.position.x`), into lists by a place (`poses[2]`, or `axes.0`) or by a field of the
wanted item (`poses[name=car]`).
"""

import math
import re
from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any, NamedTuple

from bcid.recording.formats.names import list_names, printable_name

MISSING = object()
"""Stands for a field that is not there."""
PATH = re.compile(r"[^.\[\]]+(?:\[[^\[\]]*\])*(?:\.[^.\[\]]+(?:\[[^\[\]]*\])*)*\Z")
STEP = re.compile(r"([^.\[\]]+)|\[([^\[\]]*)\]")
NUMBER_TEXT = re.compile(r"\s*[+-]?(\d+(\.\d*)?|\.\d+)([eE][+-]?\d+)?\s*\Z", re.ASCII)
NO_NUMBER_TEXTS = ("nan", "inf", "infinity")


class MissingField(Exception):
    """A field is not in a message."""

    def __init__(self, path: str, message: Any = None) -> None:
        """The field at `path` of `message`, whose own fields are named."""
        names = list_names(message) if isinstance(message, Mapping) and message else ""
        beside = f" (the message holds {names})" if names else ""
        super().__init__(f"a field is missing: {printable_name(repr(path))}{beside}")


class NotANumber(Exception):
    """A field holds something that is no number."""

    def __init__(self, value: Any, path: str = "") -> None:
        """The `value` of the field at `path`."""
        shown = {True: "true", False: "false"}.get(value) if isinstance(value, bool) else None
        name = f"field {printable_name(path)} holds " if path else ""
        super().__init__(f"{name}{shown or printable_name(repr(value))}, which is no number")


class _Chosen(NamedTuple):
    """The item of a list whose field `field` reads `value`."""

    field: str
    value: str


@lru_cache(maxsize=256)
def _steps(path: str) -> tuple[str | int | _Chosen, ...]:
    """The steps of a path: names of fields, places in lists, and items chosen by a field; one name if it is no path."""
    steps: list[str | int | _Chosen] = []
    if not PATH.match(path):
        return (path,)
    for name, choice in STEP.findall(path):
        field, is_choice, value = choice.partition("=")
        if name:
            steps.append(name)
        elif is_choice:
            steps.append(_Chosen(field.strip(), value.strip().strip("'\"")))
        else:
            steps.append(int(choice) if choice.isdecimal() and choice.isascii() else choice)
    return tuple(steps)


def chooses_item(path: str) -> bool:
    """Whether a path chooses an item of a list by one of its fields, so that a message may hold none."""
    return any(isinstance(step, _Chosen) for step in _steps(path))


def names_in_list(message: Any, path: str) -> list[str]:
    """What the items of the list, from which a path chooses by a field, have in that field; [] without such a list."""
    for step in _steps(path):
        if isinstance(step, _Chosen):
            items = message if isinstance(message, Sequence) else ()
            return [str(get_field(item, step.field, "")) for item in items]
        message = _step_into(message, step)
    return []


def _step_into(message: Any, step: str | int | _Chosen) -> Any:
    """What lies at one step of a path from a part of a message; `MISSING` where there is nothing."""
    if type(message) is dict and type(step) is str:
        return message.get(step, MISSING)
    is_list = isinstance(message, Sequence) and not isinstance(message, str | bytes)
    if isinstance(step, _Chosen):
        items = message if is_list else ()
        return next((m for m in items if str(get_field(m, step.field, MISSING)) == step.value), MISSING)
    if is_list:
        place = int(step) if isinstance(step, str) and step.isdecimal() and step.isascii() else step
        return message[place] if isinstance(place, int) and place < len(message) else MISSING
    if isinstance(message, Mapping):
        return message.get(step, MISSING)
    return _protobuf_field(message, step) if isinstance(step, str) and hasattr(message, "DESCRIPTOR") else MISSING


def _protobuf_field(message: Any, name: str) -> Any:
    """A field of a protobuf message; `MISSING` where it has none, or where a message in it was never set."""
    field = message.DESCRIPTOR.fields_by_name.get(name)
    if field is None:
        return MISSING
    value = getattr(message, name)
    # an unset message reads as one of zeros
    return value if not hasattr(value, "DESCRIPTOR") or message.HasField(name) else MISSING


def get_field(message: Any, path: str, default: Any = MISSING) -> Any:
    """The field at `path` of a decoded message, or `default` where it is not there.

    Raises:
        MissingField: there is neither the field nor a default.
    """
    part = message
    for step in _steps(path):
        part = _step_into(part, step)
        if part is MISSING:
            if default is MISSING:
                raise MissingField(path, message)
            return default
    return part


def parse_number(value: Any, path: str = "") -> float:
    """A field's value as a float: NaN where it is blank (JSON's null), +inf where it is NaN, infinite or too large.

    Raises:
        NotANumber: it is a truth value, a list or a text that is no decimal number; `path` names the field.
    """
    if type(value) is float:
        return value if math.isfinite(value) else math.inf
    if value is None:
        return math.nan
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        raise NotANumber(value, path)
    if isinstance(value, str):
        if value.strip().lower().lstrip("+-") in NO_NUMBER_TEXTS:
            return math.inf
        if not NUMBER_TEXT.match(value):
            raise NotANumber(value, path)
    try:
        number = float(value)
    except OverflowError:
        return math.inf
    return number if math.isfinite(number) else math.inf


def number_at(message: Any, path: str) -> float:
    """The number at `path` of a decoded message, NaN where an item that the path chooses is not in the message.

    Raises:
        MissingField: the field is not there.
        NotANumber: it holds something else.
    """
    return parse_number(get_field(message, path, None if chooses_item(path) else MISSING), path)
