"""Names that files can have on every system: what is written here may be copied to a computer with Windows."""

import re

FORBIDDEN = frozenset('/\\:*?"<>|')
"""Characters that no file's name can hold on Windows, or that would make a path of it."""

DEVICES = re.compile(r"(con|prn|aux|nul|conin\$|conout\$|(com|lpt)[0-9¹²³])\s*(\..*)?", re.IGNORECASE | re.DOTALL)
"""Names that stand for a device on Windows, whatever ending follows: CON, COM1.csv (Microsoft, "Naming Files")."""


def is_device_name(name: str) -> bool:
    """Whether a file called `name`, with or without an ending, would be a device on Windows."""
    return DEVICES.fullmatch(name) is not None


def is_plain_name(name: str) -> bool:
    """Whether files called `name` and an ending can be on any system: printable, no path, no part of one, no device."""
    printable = bool(name.strip(". ")) and name.isprintable()
    return printable and not FORBIDDEN & set(name) and not is_device_name(name)
