"""How FMUs are checked: without a compiler, and where their poses are not those of their twists."""

from __future__ import annotations

import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from exported_models import make_export

from bcid.errors import InputRefused
from bcid.export.check import NO_COMPILER, find_compiler
from bcid.export.exported import Exported
from bcid.export.fmi import check_fmus as checking
from bcid.export.fmi import fmu as making
from bcid.export.fmi.check_fmus import check_fmus
from bcid.export.fmi.description import describe_fmi2, describe_fmi3, list_variables
from bcid.export.fmi.fmu import write_fmus

fmpy = pytest.importorskip("fmpy", reason="fmpy is not installed")


def written_fmus(e: Exported, folder: Path) -> None:
    for name, content in write_fmus(e).items():
        (folder / name).write_bytes(content)


def test_without_a_compiler_only_sources_are_written(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    for module in (making, checking):
        monkeypatch.setattr(module, "find_compiler", lambda: None)
    e = make_export("newton-euler")
    written_fmus(e, tmp_path)
    for path in tmp_path.iterdir():
        with zipfile.ZipFile(path) as fmu:
            assert not [member for member in fmu.namelist() if member.startswith("binaries")]
    assert check_fmus(tmp_path, e).not_checked == NO_COMPILER


@pytest.mark.skipif(find_compiler() is None, reason="no C compiler")
def test_poses_that_are_not_those_of_the_twists_are_refused(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    e, drive = make_export("newton-euler"), checking.drive_fmu
    written_fmus(e, tmp_path)

    def drive_away(*given: Any) -> Any:
        driven = drive(*given)
        driven[:, :3] += 1e-7 * np.arange(len(driven))[:, None]
        return driven

    monkeypatch.setattr(checking, "drive_fmu", drive_away)
    with pytest.raises(InputRefused, match="its poses are off those of its twists"):
        check_fmus(tmp_path, e)


def test_variables_say_of_which_point_they_are_and_what_commands_mean() -> None:
    e = make_export("newton-euler-augmented")
    meanings = {v.quantity.name: v.quantity.meaning for v in list_variables(e)}
    assert meanings["v_y"] == "velocity to the left, of the tracked point"
    assert meanings["p_x_0"] == "position in the world at the start, of the tracked point"
    assert meanings["delta_0"] == "steering angle, left positive at the start"
    assert meanings["x.p_x"] == "position in the world, of the centre of gravity"
    assert "share of full brake" in meanings["u_m"]
    for text in (describe_fmi2(e, "token", []), describe_fmi3(e, "token")):
        assert 'name="v_y"' in text
        assert "velocity to the left, of the tracked point" in text
