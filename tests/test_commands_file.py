"""Commands beside a Motive export, with columns, units and clocks of their own; and formats that are not read."""

from __future__ import annotations

import datetime
import io
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from making import circling_take

from bcid.errors import InputRefused
from bcid.recording.formats.raw import RawTake
from bcid.recording.read import read_raw_take, read_recording
from bcid.vehicle import Vehicle

T = np.arange(400) / 20.0
HEAD = "time_s,steering_rad,throttle_mps\n"


def beside(folder: Path, text: str, vehicle: Vehicle, **commands: Any) -> RawTake:
    """What is read of a circle with these commands beside it, which the vehicle file maps."""
    path = circling_take(folder)
    path.with_suffix(".commands.csv").write_text(text, encoding="utf-8")
    return read_raw_take(path, mapped(vehicle, **commands))


def mapped(vehicle: Vehicle, **commands: Any) -> Vehicle:
    """The vehicle file with this table [commands]."""
    tables = vehicle.model_dump(by_alias=True, exclude_unset=True)
    return Vehicle.model_validate({**tables, "commands": commands} if commands else tables)


def rows(stamp: Any = lambda t: f"{t:.3f}", steer: str = "0.5", gas: str = "1.2") -> str:
    """The rows of constant commands."""
    return "".join(f"{stamp(t)},{steer},{gas}\n" for t in T)


def clock(t: float) -> str:
    """A date's clock, as ISO 8601 has it, at t s after 14:15:30.125."""
    return f"2026-05-04 14:{15 + int((30.125 + t) // 60):02d}:{(30.125 + t) % 60:06.3f}"


MAPPED: dict[str, tuple[str, dict[str, Any]]] = {
    "as it is": (HEAD + rows(), {}),
    "other names": (
        "Time (s),Steering [rad],Throttle\n" + rows(),
        {"time_s": "Time (s)", "steering_rad": "Steering [rad]", "throttle_mps": "Throttle"},
    ),
    "ms, degrees and percent": (
        HEAD + rows(lambda t: f"{1000 * t:.0f}", "28.64788976", "60"),
        {
            "time_s": {"from": "time_s", "gain": 0.001},
            "steering_rad": {"from": "steering_rad", "gain": 0.017453292519943295},
            "throttle_mps": {"from": "throttle_mps", "gain": 0.02},
        },
    ),
    "no header": (rows(), {"time_s": "#1", "steering_rad": "#2", "throttle_mps": "#3"}),
    "a row of units": (HEAD + "s,rad,m/s\n" + rows(), {}),
    "Unix time": (HEAD + rows(lambda t: f"{1.78e9 + t:.3f}"), {"time_zero": 1780000000.0}),
    "Unix time with an offset": (
        HEAD + rows(lambda t: f"{1.78e9 + t:.3f}"), {"time_s": {"from": "time_s", "offset": -1.78e9}},
    ),
    "ISO 8601": (HEAD + rows(clock), {"time_zero": "2026-05-04 14:15:30.125"}),
    "ISO 8601, and a date of TOML's at zero": (
        HEAD + rows(clock), {"time_zero": datetime.datetime(2026, 5, 4, 14, 15, 30, 125_000)},
    ),
    "ISO 8601, and a clock time at zero": (HEAD + rows(clock), {"time_zero": "14:15:30.125"}),
}  # fmt: skip


@pytest.mark.parametrize("name", list(MAPPED))
def test_mapped_commands_are_those_of_the_usual_file(name: str, vehicle: Vehicle, tmp_path: Path) -> None:
    text, commands = MAPPED[name]
    take = beside(tmp_path, text, vehicle, **commands)
    np.testing.assert_allclose(take.command_time_s, T, atol=1e-6)
    np.testing.assert_allclose(take.command, np.tile([0.5, 1.2], (len(T), 1)), atol=1e-8)


UNMAPPED: dict[str, tuple[str, str, str]] = {
    "other names": ("Time (s),Steering [rad],Throttle\n" + rows(), "'time_s': is not in the file", "[commands]"),
    "no header": (rows(), "no header", 'time_s = "#1"'),
    "Unix time": (HEAD + rows(lambda t: f"{1.78e9 + t:.3f}"), "times of a clock", "time_zero = 1780000000.0"),
    "ISO 8601": (HEAD + rows(clock), "times of a clock", 'time_zero = "2026-05-04 14:15:30.125"'),
    "ms": (HEAD + rows(lambda t: f"{1000 * t:.0f}"), "hold for", "gain = 0.001"),
    "another zero": (HEAD + rows(lambda t: f"{t + 5e4:.3f}"), "do not overlap", "time_zero"),
}


@pytest.mark.parametrize("name", list(UNMAPPED))
def test_unmapped_commands_are_refused_with_a_step_that_works(name: str, vehicle: Vehicle, tmp_path: Path) -> None:
    text, cause, step = UNMAPPED[name]
    path = circling_take(tmp_path)
    path.with_suffix(".commands.csv").write_text(text, encoding="utf-8")
    with pytest.raises(InputRefused, match=cause) as error:
        read_recording(path, vehicle)
    assert step in error.value.next_step
    assert "topic" not in error.value.next_step


def test_the_export_s_capture_start_places_local_times(vehicle: Vehicle, tmp_path: Path) -> None:
    path = circling_take(tmp_path)
    text = path.read_text(encoding="utf-8")
    key, value = "Capture Start Time,", text.partition("Capture Start Time,")[2].partition(",")[0]
    path.write_text(text.replace(key + value, key + "2026-05-04 02.15.30.125 PM", 1), encoding="utf-8")
    path.with_suffix(".commands.csv").write_text(HEAD + rows(clock))
    take = read_raw_take(path, mapped(vehicle, time_zero="capture start"))
    np.testing.assert_allclose(take.command_time_s, T, atol=1e-6)
    assert any(i.kind == "command clock" and i.action == "warning" for i in take.irregularities)
    path.with_suffix(".commands.csv").write_text(HEAD + rows(lambda t: f"{1.78e9 + t:.3f}"))
    with pytest.raises(InputRefused, match="local time"):
        read_raw_take(path, mapped(vehicle, time_zero="capture start"))


def test_a_brake_is_a_channel(vehicle: Vehicle, tmp_path: Path) -> None:
    text = HEAD.replace("\n", ",brake\n") + rows().replace("\n", ",30\n")
    take = beside(tmp_path, text, vehicle, brake_share={"from": "brake", "gain": 0.01})
    np.testing.assert_allclose(take.channels["brake_share"][1], 0.3)


# --- formats that are not read -------------------------------------------------------------------------------------


def zipped(*names: str) -> bytes:
    """A zip archive with empty files of these names."""
    data = io.BytesIO()
    with zipfile.ZipFile(data, "w") as archive:
        for name in names:
            archive.writestr(name, "")
    return data.getvalue()


FOREIGN: dict[str, tuple[bytes, str, str]] = {
    "take.tak": (b"\x01\x02\x00motive", "Motive's own format", "Export Tracking Data"),
    "take.c3d": (b"\x02P" + bytes(600), "C3D", "CSV"),
    "take.xlsx": (zipped("xl/workbook.xml"), "spreadsheet", "CSV"),
    "take.mat": (b"MATLAB 5.0 MAT-file" + bytes(200), "MATLAB", "writetable"),
    "take.npz": (zipped("x.npy"), "NumPy", "to_csv"),
    "take.npy": (b"\x93NUMPY\x01\x00" + bytes(200), "NumPy", "to_csv"),
    "take.h5": (b"\x89HDF\r\n\x1a\n" + bytes(200), "HDF5", "to_parquet"),
    "take.feather": (b"ARROW1\x00\x00" + bytes(200), "Arrow", "to_parquet"),
    "take.pkl": (b"\x80\x04\x95" + bytes(50), "pickle", "to_parquet"),
    "take.json": (b'[{"t": 0}]', "JSON", "to_csv"),
    "take.csv.gz": (b"\x1f\x8b\x08\x00" + bytes(50), "gzip", "unpack"),
    "really_excel.csv": (zipped("xl/workbook.xml"), "archive", "unpack"),
}


@pytest.mark.parametrize("name", list(FOREIGN))
def test_a_format_that_is_not_read_is_named_with_what_converts_it(name: str, vehicle: Vehicle, tmp_path: Path) -> None:
    content, what, step = FOREIGN[name]
    (tmp_path / name).write_bytes(content)
    with pytest.raises(InputRefused, match=what) as error:
        read_raw_take(tmp_path / name, vehicle)
    assert step in error.value.next_step


def test_a_row_cut_among_quoted_identities_is_refused(vehicle: Vehicle, tmp_path: Path) -> None:
    """Real exports quote the IDs of rigid bodies, which turned the check of rows off."""
    path = circling_take(tmp_path)
    lines = path.read_text(encoding="utf-8").split("\n")
    ids = next(i for i, line in enumerate(lines) if line.startswith((",ID", ",")) and ",ID," in line)
    lines[ids] = ",".join(f'"{c}"' if i > 1 else c for i, c in enumerate(lines[ids].strip().split(",")))
    lines[300] = lines[300].rpartition(",")[0][:-4]
    path.write_text("\n".join(lines), encoding="utf-8")
    with pytest.raises(InputRefused, match="line 301: holds 9 cells where rows have 10"):
        read_raw_take(path, vehicle)
