"""How short a drive may be, why, and what is said of a short one."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cars import CAR

from bcid.cli.show import diagnosis_tables
from bcid.diagnosis.diagnose import diagnose_recordings
from bcid.diagnosis.limits import JUDGE_LIMITS, SEARCH_LIMITS
from bcid.diagnosis.summary import summarise_diagnosis
from bcid.documents.diagnosis import Detectable, DiagnosisDocument, NotExcited
from bcid.effects.table import ENTRIES
from bcid.errors import InputRefused
from bcid.estimate.run import estimate_motion
from bcid.estimate.tune import tune_estimator
from bcid.estimate.tuning import Tuning
from bcid.likelihood import score_test
from bcid.likelihood.limits import LIKELIHOOD_LIMITS
from bcid.likelihood.take import GROUP_S, N_NUISANCE, SEGMENT_S, build_take
from bcid.recording.checks.contacts import find_contacts
from bcid.recording.checks.health import assess_health
from bcid.recording.limits import HEALTH
from bcid.recording.read import read_recording
from bcid.recording.types import Recording, Stream
from bcid.report.diagnosis_page import write_diagnosis_page
from bcid.report.limits import LIMITS
from bcid.report.verdict_words import short_take_sentence
from bcid.vehicle import Vehicle, read_vehicle

LEAST = LIKELIHOOD_LIMITS.min_segments


# --- why twelve ----------------------------------------------------------------------------------------------------


def test_the_least_take_has_as_many_different_signs_as_are_drawn_and_a_segment_in_each_block() -> None:
    """And it is the least number that has: the reason in the limit's comment is its value."""

    def bears(segments: int) -> bool:
        return 2 ** (segments - 1) > score_test.NULL_DRAWS and segments >= JUDGE_LIMITS.min_blocks

    assert bears(LEAST)
    assert not bears(LEAST - 1)
    assert HEALTH.min_motion_s == LEAST * SEGMENT_S


def test_draws_of_signs_repeat_each_other_below_the_least_and_hardly_from_it_on() -> None:
    """Of 999 draws: how many differ by more than a sign common to all segments."""
    different = {
        S: len(np.unique(signs * signs[:, :1], axis=0))
        for S in (6, 8, LEAST, 20)
        for signs in [np.random.default_rng(0).choice((-1.0, 1.0), (score_test.NULL_DRAWS, S))]
    }
    assert different[6] <= 32
    assert different[8] <= 128
    assert different[LEAST] > 0.75 * score_test.NULL_DRAWS
    assert different[20] > 0.99 * score_test.NULL_DRAWS


def test_half_of_the_least_take_has_more_numbers_than_any_hypothesis_has_parameters() -> None:
    rows = LIKELIHOOD_LIMITS.min_coverage * SEGMENT_S / GROUP_S
    numbers = LEAST // 2 * (3 * rows - N_NUISANCE)
    largest = sorted((len(e.parameters) for e in ENTRIES.values()), reverse=True)
    assert numbers > 5 * (12 + sum(largest[: SEARCH_LIMITS.max_effects]))


# --- where a take ends too soon ------------------------------------------------------------------------------------


def test_a_take_of_fewer_is_refused_and_one_of_as_many_is_not(
    recording: Recording, vehicle: Vehicle, tuning: Tuning
) -> None:
    limit = vehicle.steering.max_angle_rad

    def first(seconds: float) -> Recording:
        known = recording.poses.time_s < recording.poses.time_s[0] + seconds
        poses = Stream(recording.poses.time_s[known], recording.poses.values[known])
        return Recording(
            "short", recording.sources, poses, recording.commands, recording.rate_hz, recording.hold_s
        )  # fmt: skip

    def built(seconds: float) -> int | str:
        short = first(seconds)
        try:
            return build_take([short], [estimate_motion(short, vehicle, tuning)], CAR, limit)[0].segments
        except InputRefused as refused:
            return str(refused)

    assert not find_contacts(first(40.0))
    found = [built(seconds) for seconds in np.arange(15.0, 31.0, SEGMENT_S).tolist()]
    refusals = [said for said in found if isinstance(said, str)]
    assert min(n for n in found if isinstance(n, int)) == LEAST
    assert f"only {LEAST - 1} stretches of 1.5 s in motion can be used, {LEAST} are the least" in refusals[-1]
    assert "record a longer take" in refusals[-1]


def test_a_real_drive_of_13_stretches_is_told_with_its_gate(recordings_folder: Path) -> None:
    """It was refused for seven too few.  Its pose jumps by 4.43 m once: that is left out, and no physics."""
    vehicle = read_vehicle(Path(__file__).parents[1] / "pipelines" / "f1tenth" / "vehicle.toml")
    path = recordings_folder / "f1tenth_ini" / "physical" / "2025-10-10_04-59-59_sysid_const_steer.csv"
    drive = read_recording(path, vehicle)
    assert assess_health(drive, vehicle).go
    assert [i.count for i in drive.irregularities if i.kind == "pose jump"] == [1]
    estimate = estimate_motion(drive, vehicle, tune_estimator([drive], vehicle, 0.1, 0.3, {}))
    told = summarise_diagnosis(diagnose_recordings([drive], [estimate], vehicle))
    assert told.stretches == 13
    assert told.gate_nats is not None
    # chance reaches about log(10^4), the more the more trials there are
    assert 9.0 < told.gate_nats < 60.0
    assert f"less than some {told.gate_nats:.0f} nats" in short_take_sentence(told)
    assert told.not_excited


# --- what is said --------------------------------------------------------------------------------------------------


def short(**about: Any) -> DiagnosisDocument:
    given = {"verdict": "nothing-found", "stretches": 13, "gate_nats": 17.4} | about
    return DiagnosisDocument(**given)


def test_a_short_take_s_gate_and_what_it_cannot_show_are_said(tmp_path: Path) -> None:
    unseen = (
        NotExcited(effect="yaw_scrub", parameter="c", smallest_detectable=Detectable(value=3.0, unit="N m s")),
        NotExcited(effect="marker_offset", parameter="d_x", smallest_detectable=Detectable(value=0.2, unit="m")),
        NotExcited(effect="marker_offset", parameter="d_y", smallest_detectable=Detectable(value=0.2, unit="m")),
    )
    said = short_take_sentence(short(not_excited=unseen))
    assert "13 stretches" in said
    assert "less than some 17 nats" in said
    assert "2 effects show only where they are unusually large" in said
    assert "1 effect shows only where it is" in short_take_sentence(short(not_excited=unseen[:1]))
    assert said in "".join(str(part) for part in diagnosis_tables(short(not_excited=unseen)).renderables[:1])
    page = tmp_path / "diagnosis.html"
    no_pictures = {"time_s": np.empty(0), "start": np.empty(0)}
    write_diagnosis_page(short(not_excited=unseen), no_pictures, no_pictures, page)
    assert "A short take: of 13 stretches" in page.read_text(encoding="utf-8")


@pytest.mark.parametrize("about", [{"stretches": LIMITS.short_stretches}, {"stretches": None}, {"gate_nats": None}])
def test_nothing_is_said_of_a_usual_take_or_of_an_older_document(about: dict[str, Any]) -> None:
    assert short_take_sentence(short(**about)) == ""
