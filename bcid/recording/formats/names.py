"""Names that stand in files (topics, bodies, fields), and what parsers say, as messages to people show them."""

from collections.abc import Iterable

from bcid.errors import printable, shorten

SHOWN_LENGTH = 80  # characters of a name
SHOWN_NAMES = 12  # names of a list
SHOWN_ERROR_LENGTH = 300  # characters of what a parser says


def printable_name(name: object, length: int = SHOWN_LENGTH) -> str:
    """A name from a file, without characters that a terminal might obey, and cut to `length` characters."""
    return printable(shorten(str(name), length), "")


def describe_error(error: Exception) -> str:
    """What a parser says of content that nobody vouches for, printable and cut; the error's kind if it says nothing."""
    if isinstance(error, RecursionError):
        return "it is nested too deeply"
    return printable_name(" ".join(str(error).split()) or type(error).__name__, SHOWN_ERROR_LENGTH)


def list_names(names: Iterable[object]) -> str:
    """The first `SHOWN_NAMES` of some names from a file, printable and joined by commas; "none" without any."""
    every = list(names)
    shown = [printable_name(name) for name in every[:SHOWN_NAMES]] + ["…"] * (len(every) > SHOWN_NAMES)
    return ", ".join(shown) or "none"
