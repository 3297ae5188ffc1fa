"""Effects of a user's own: read and checked, in the compiled car, in lanes, in derivatives."""

from __future__ import annotations

from pathlib import Path

import pytest
from own_effects import ACTUATORS, DRAG, MAGNET, REFUSED

from bcid.effects.own_file import OwnFile, own_effects_in_use, read_own_effects
from bcid.effects.table import EFFECTS, ENTRIES, OFF, effect_switches
from bcid.errors import InputRefused, UsageError


def own_file(folder: Path, text: str) -> OwnFile:
    """The effects that a file with this text declares."""
    path = folder / "effects.py"
    path.write_text(text, encoding="utf-8")
    return read_own_effects(path)


@pytest.mark.parametrize("name", sorted(REFUSED))
def test_a_file_that_is_wrong_is_refused(name: str, tmp_path: Path) -> None:
    text, cause = REFUSED[name]
    with pytest.raises(InputRefused) as refused:
        own_file(tmp_path, text)
    assert cause in str(refused.value)
    assert "effects.py" in str(refused.value)
    assert "next:" in str(refused.value)


def test_what_is_wrong_is_told_at_once(tmp_path: Path) -> None:
    """Of two effects with faults each is told of."""
    second = DRAG[DRAG.index("@effect") :].replace("own_drag", "yaw_scrub")
    with pytest.raises(InputRefused) as refused:
        own_file(tmp_path, DRAG.replace("kg s^-1", "kg m^-1") + second)
    assert "own_drag" in str(refused.value)
    assert "yaw_scrub" in str(refused.value)
