"""Inputs that once failed, in a folder beside the project: each is read, refused or called no-go as it ought to be.

What the verdict must say is given as a regular expression; "" means that nothing is told.
"""

from __future__ import annotations

import os
import re
from pathlib import Path

import pytest

from bcid.errors import InputRefused
from bcid.recording.checks.health import assess_health
from bcid.recording.read import read_recording
from bcid.vehicle import read_vehicle

CASES = Path(os.environ.get("BCID_CASES", Path(__file__).parents[2] / "shared" / "cases"))
pytestmark = pytest.mark.skipif(not CASES.is_dir(), reason="the folder shared/cases is not there")

GO = {
    "00-clean/drive.csv": "", "00-clean/drive.mcap": "", "00-clean/table.csv": "",
    "01-motive-quoted-id-row-cut/drive.csv": "", "06-unix-commands/units.csv": "units row",
    "10-outer-join/merge.csv": "", "10-outer-join/outer.csv": "", "10-outer-join/outer3.csv": "",
    "14-numbers/de.csv": "dialect", "14-numbers/de_thousands.csv": "notation", "14-numbers/fortran.csv": "notation",
    "14-numbers/preamble.csv": "preamble", "14-numbers/sep.csv": "dialect", "14-numbers/spaces.csv": "dialect",
    "14-numbers/trail.csv": "", "14-numbers/unicode_minus.csv": "notation", "14-numbers/units_row.csv": "units row",
    "21-yup-in-ros/yup_Y.mcap": "", "22-other-pose-types/named.mcap": "", "22-other-pose-types/parray.mcap": "",
    "24-stamps/fl.mcap": "", "24-stamps/iso.mcap": "", "24-stamps/ms.mcap": "", "24-stamps/ns.mcap": "",
    "24-stamps/ros1.mcap": "", "24-stamps/sd.mcap": "", "24-stamps/tx.mcap": "",
    "25-rosbag2-folders/extra": "split bag", "25-rosbag2-folders/prefix": "",
    "30-vehicle-file-units/minimal.csv": "", "30-vehicle-file-units/drive_rear.csv": "vehicle file",
    "30-vehicle-file-units/lflr.csv": "vehicle file", "30-vehicle-file-units/marker_wrong.csv": "vehicle file",
    "30-vehicle-file-units/wheelbase2.csv": "vehicle file", "33-yaw-offset-advice/t.csv": "yaw offset",
    "43-bursty-header-stamps/bursts.mcap": "bursts", "44-body-axes/straight.csv": "",
    "44-body-axes/upside_down.csv": "", "44-body-axes/x_nearly_up.csv": "body axes",
    "44-body-axes/x_up.csv": "body axes", "44-body-axes/z_up_body.csv": "",
    "53-parquet/plain.parquet": "integrity", "53-parquet/i16mm.parquet": "integrity",
    "53-parquet/dict.parquet": "integrity", "53-parquet/tz.parquet": "integrity", "53-parquet/td.parquet": "integrity",
    "54-claims/frozen022.csv": "frozen pose", "54-claims/frozen25.csv": "frozen pose",
    "55-float32-full-lock/full_lock.mcap": "", "55-float32-full-lock/over.mcap": "steering command",
    "60-dead-end-advice/cm.mcap": "", "60-dead-end-advice/mm.mcap": "", "60-dead-end-advice/mm.csv": "",
    "r07-go-for-nonsense/19_yaw_spikes.mcap": "yaw jump", "r07-go-for-nonsense/yaw_plus90_for_3s.mcap": "yaw jump",
    "70-command-phase/train_5.mcap": "",
}  # fmt: skip
NO_GO = {
    "30-vehicle-file-units/clock_ms.csv": "late", "31-commands/early3.csv": "early", "31-commands/late05.csv": "late",
    "31-commands/other_take.csv": "another take", "31-commands/thr_const.csv": "throttle .* dead",
    "31-commands/thr_duty.csv": "duty", "31-commands/thr_pct_min.csv": "percent", "54-claims/cmd_dead.csv": "frozen",
    "54-claims/cmd_frozen.csv": "frozen", "54-claims/sign_change.csv": "sign changes",
    "r07-go-for-nonsense/commands_half_second_late.mcap": "late", "r07-go-for-nonsense/noise_10cm.mcap": "noise",
    "r07-go-for-nonsense/steering_all_zero.mcap": "dead", "r07-go-for-nonsense/yaw_all_zero.mcap": "not logged",
}  # fmt: skip
REFUSED = {
    "01-motive-quoted-id-row-cut/cut_cells.csv": "line 2008: holds 7 cells",
    "01-motive-quoted-id-row-cut/cut_number.csv": "line 2008: holds 9 cells",
    "01-motive-quoted-id-row-cut/merged.csv": "line 2008: holds 18 cells",
    "01-motive-quoted-id-row-cut/table_quoted.csv": "line 2002: holds 3 cells",
    "06-unix-commands/iso.csv": "time_zero", "06-unix-commands/unix.csv": "time_zero",
    "06-unix-commands/nohead.csv": "no header", "06-unix-commands/xnames.csv": r"\[commands\]",
    "06-unix-commands/ms.csv": "seconds", "14-numbers/hashes.csv": "too narrow",
    "21-yup-in-ros/swap_lefthanded.mcap": "mirrored", "21-yup-in-ros/yup_Z.mcap": 'up_axis = "Y"',
    "22-other-pose-types/pose.mcap": "quaternion", "23-two-command-topics/vesc.mcap": "two topics",
    "25-rosbag2-folders/db3bag": "SQLite", "25-rosbag2-folders/zstdbag": "unpack",
    "25-rosbag2-folders/half_compressed": "unpack", "30-vehicle-file-units/angle_deg.csv": "degrees",
    "30-vehicle-file-units/lengths_cm.csv": "cm", "30-vehicle-file-units/lengths_mm.csv": "mm",
    "30-vehicle-file-units/marker_mm.csv": "mm", "30-vehicle-file-units/mass_g.csv": "in g",
    "30-vehicle-file-units/tau_ms.csv": "ms", "30-vehicle-file-units/yaw_deg.csv": "degrees",
    "31-commands/pwm.csv": "throttle", "31-commands/swap.csv": "swapped", "31-commands/thr_rev.csv": "other sign",
    "53-parquet/twice.parquet": "twice", "r02-protobuf-traceback/one_message_cut.mcap": "message 701",
    "r04-other-tracebacks/column_twice.parquet": "twice", "r04-other-tracebacks/json_nested.mcap": "nested",
    "r04-other-tracebacks/json_stamp_1e400.mcap": "stamp", "r04-other-tracebacks/ros_recursive.mcap": "by itself",
    "r04-other-tracebacks/ros_wstring.mcap": "wstring", "r06-quote-swallows-rows/take.csv": "quotation mark",
    "r08-small-file-much-memory/b1.mcap": "messages",
}  # fmt: skip


def vehicle_file(path: Path) -> Path:
    """The vehicle file that a case has beside it, of its own name or of its folder."""
    own = (path.with_suffix(".vehicle.toml"), path.parent / "vehicle.toml", path.parent / "v.toml")
    beside = [p for p in own if p.is_file()] or sorted(path.parent.glob("*.vehicle.toml"))
    return beside[0] if beside else CASES / "00-clean" / "drive.vehicle.toml"


@pytest.mark.parametrize(("case", "told"), GO.items())
def test_what_can_be_used_is_go(case: str, told: str) -> None:
    vehicle = read_vehicle(vehicle_file(CASES / case))
    recording = read_recording(CASES / case, vehicle)
    assert assess_health(recording, vehicle).go
    kinds = {i.kind for i in recording.irregularities}
    assert told in " ".join(kinds) if told else not kinds


@pytest.mark.parametrize(("case", "cause"), NO_GO.items())
def test_what_cannot_be_used_is_no_go_for_its_cause(case: str, cause: str) -> None:
    vehicle = read_vehicle(vehicle_file(CASES / case))
    health = assess_health(read_recording(CASES / case, vehicle), vehicle)
    assert not health.go
    assert re.search(cause, health.sentence), health.sentence


@pytest.mark.parametrize(("case", "cause"), REFUSED.items())
def test_what_is_no_recording_is_refused_by_its_cause(case: str, cause: str) -> None:
    with pytest.raises(InputRefused, match=cause):
        read_recording(CASES / case, read_vehicle(vehicle_file(CASES / case)))
