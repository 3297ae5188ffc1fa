"""What counts as right in answers about real recordings, and the figures of it."""

from __future__ import annotations

import json
from typing import Any

import pytest

from bcid.proof.real.figures import real_document, real_figures, with_goals
from bcid.proof.real.jobs import Job
from bcid.proof.real.questions import DrivePair, EditedQuestion, RecordedDrive, WithheldQuestion, Withholding
from bcid.proof.real.replication import effects_of_figures
from bcid.proof.real.scoring import score_jobs
from bcid.proof.real.variations import STARTS

LAG = WithheldQuestion("take.csv", "lag", Withholding(effects=["motor_lag"]))


def finding(effect: str, *twins: str, **values: tuple[float, float]) -> dict[str, Any]:
    return {"effect": effect, "kind": "vehicle", "twins": list(twins), "values": values}


def said(*findings: dict[str, Any], **more: Any) -> dict[str, Any]:
    """The row of a diagnosis with these findings, of a question that is worth 100 nats."""
    row = {
        "verdict": "named" if findings else "unknown", "findings": list(findings), "remainder": {"channel": "fx"},
        "corrections": [], "gate": 14.0, "worth": 100.0, "equivalents": {}, "ratios": {"v_x": 2.0, "yaw_rate": 1.1},
    }  # fmt: skip
    return {**row, **more}


def scored(question: Any, row: dict[str, Any], whole: dict[str, Any] | None = None, case: str = "") -> dict[str, Any]:
    """The scores of a question's row, beside the row of the whole simulation."""
    job = Job("own", "take.csv", case, dict, question=question, beside=("whole",))
    return score_jobs([job], {"own": row} | ({"whole": whole} if whole else {}))[0]


@pytest.mark.parametrize(
    ("findings", "right", "first", "false"),
    [
        ([finding("motor_lag"), finding("rear_toe")], True, True, ["rear_toe"]),
        ([finding("rear_toe"), finding("pose_scale", "motor_lag")], True, False, ["rear_toe"]),
        ([finding("motor_delay")], True, True, []),  # which the drive cannot tell from the lag
        ([finding("steering_backlash"), finding("motor_lag")], True, False, []),  # seen with nothing withheld as well
        ([finding("pose_latency", "steering_delay+motor_lag")], False, False, ["pose_latency"]),
        ([], False, False, []),  # unknown in fx is no name
        ([finding("rear_toe", "motor_lag", "yaw_scrub", "pose_scale")], True, True, []),
        ([finding("rear_toe", "motor_lag", "yaw_scrub", "pose_scale", "motor_sag")], False, False, ["rear_toe"]),
        ([finding("steering_drag"), finding("motor_lag")], True, True, []),  # another size of what the simulation has
    ],
)
def test_right_is_what_is_withheld_or_what_cannot_be_told_from_it(
    findings: list[dict[str, Any]], right: bool, first: bool, false: list[str]
) -> None:
    row = said(*findings, equivalents={"motor_delay": 1.2}, has=["steering_drag"])
    told = scored(
        LAG, row, said(finding("pose_latency", "steering_backlash"), finding("motor_sag"), misfit={"rmse": 1})
    )
    false = [name for name in false if name != "pose_latency"]  # shown by the whole simulation
    assert (told["tier"], told["right"], told["first"], told["false"]) == ("withheld", right, first, false)
    assert told["ratio"] == 2.0  # a motor's lag shows in the speed
    assert told["misfit"] == {"rmse": 1}


@pytest.mark.parametrize(("names", "right"), [([], True), (["rear_toe"], False), (["motor_lag"], False)])
def test_what_is_worth_less_than_the_gate_is_a_control(names: list[str], right: bool) -> None:
    told = scored(LAG, said(*map(finding, names), worth=13.9))
    assert (told["tier"], told["right"]) == ("control", right)
    assert told["false"] == names


def test_a_correction_of_the_base_model_that_is_withheld_is_named_by_correcting_it() -> None:
    """A motor that fades has no place in the vocabulary of names."""
    fade = WithheldQuestion("take.csv", "fade", Withholding(effects=["motor_fade"]))
    told = scored(fade, said(finding("rear_toe"), corrections=["motor_fade"]))
    assert (told["right"], told["first"], told["false"]) == (True, True, ["rear_toe"])
    assert not scored(fade, said(finding("rear_toe")))["right"]


@pytest.mark.parametrize(
    ("names", "fails", "right"),
    [
        ([], False, True), (["rear_toe"], False, False), (["steering_drag"], False, True),
        (["steering_backlash", "pose_latency"], True, True), (["steering_backlash", "mass_change"], True, False),
        (["rear_toe"], True, False), (["pose_latency"], False, False),
    ],
)  # fmt: skip
def test_nothing_may_be_named_where_nothing_is_withheld_nor_the_vehicle_where_the_tracking_fails(
    names: list[str], fails: bool, right: bool
) -> None:
    """But what the simulation has already, of another size."""
    drive = RecordedDrive(
        recording="take.csv", tracking_fails=fails, known=["steering_backlash"] if fails else []
    )  # fmt: skip
    told = scored(drive, said(*map(finding, names), has=["steering_drag"]))
    assert (told["tier"], told["right"]) == ("control", right)


@pytest.mark.parametrize(
    ("value", "se", "before", "unsure", "right"),
    [
        (0.05, 0.001, -0.01, 0.001, True),
        (0.05, 0.001, 0.01, 0.001, False),  # a third less than the edit
        (0.06, 0.001, 0.0, 0.001, True),
        (0.043, 0.006, 0.0, 0.001, True),  # within what it is sure of
        (0.02, 0.1, 0.0, 0.1, False),  # which may not be anything
        (0.02, 0.1, 0.02, 0.1, False),  # nothing more than there was before
        (None, 0.0, 0.0, 0.0, False),
    ],
)
def test_an_edit_is_what_a_drive_shows_beyond_what_it_showed_before(
    value: float | None, se: float, before: float, unsure: float, right: bool
) -> None:
    """A pose that comes 0.06 s late, where it came `before` already."""
    found = [finding("pose_latency", tau=(value, se))] if value is not None else []
    row = scored(EditedQuestion("take.csv", "pose_latency", 0.06), said(*found, before={"tau": [before, unsure]}))
    assert (row["tier"], row["right"], row["value"]) == ("edited", right, value)


@pytest.mark.parametrize(("worth", "tier"), [(60.0, "edited"), (11.0, "control")])
@pytest.mark.parametrize(("names", "false"), [((), ()), (("rear_toe",), ("rear_toe",))])
def test_an_edit_that_a_drive_hardly_shows_is_a_control(
    worth: float, tier: str, names: tuple[str, ...], false: tuple[str, ...]
) -> None:
    """Its worth against the gate of 20 nats; right is then to name nothing else."""
    answer = said(*map(finding, names), before={"tau": [0.0, 0.001]}, worth=worth, gate=20.0)
    row = scored(EditedQuestion("take.csv", "pose_latency", 0.06), answer)
    assert (row["tier"], row["right"], tuple(row["false"])) == (tier, tier == "control" and not false, false)


@pytest.mark.parametrize(("value", "right"), [(0.061, True), (0.5, False), (-0.06, False)])
def test_an_edit_that_is_named_needs_its_size_whatever_it_is_worth(value: float, right: bool) -> None:
    found = finding("pose_latency", tau=(value, 0.001))
    answer = said(found, before={"tau": [0.0, 0.001]}, worth=11.0, gate=20.0)
    row = scored(EditedQuestion("take.csv", "pose_latency", 0.06), answer)
    assert (row["tier"], row["right"], row["false"]) == ("edited", right, [])


@pytest.mark.parametrize(
    ("d_y", "more", "right"),
    [(-0.007, (), True), (0.015, (), False), (-0.007, ("rear_toe",), False)],
)
def test_an_edit_is_nothing_else(d_y: float, more: tuple[str, ...], right: bool) -> None:
    """The tracked point is moved ahead, not to the side, and nothing else is edited."""
    found = [finding("marker_offset", d_x=(0.033, 0.001), d_y=(d_y, 0.001)), *map(finding, more)]
    before = {"d_x": [0.002, 0.001], "d_y": [-0.006, 0.001]}
    row = scored(EditedQuestion("take.csv", "marker_offset", 0.03), said(*found, before=before))
    assert (row["right"], row["false"]) == (right, list(more))


PAIR = DrivePair(fit="one.csv", test="other.csv")


@pytest.mark.parametrize(
    ("only", "same", "changed", "right"),
    [([], True, [], True), ([], False, [], False), ([], False, ["motor_lag"], True), (["rear_toe"], True, [], False)],
)
def test_two_drives_of_a_day_show_the_same_or_tell_what_has_changed(
    only: list[str], same: bool, changed: list[str], right: bool
) -> None:
    size = {"effect": "motor_lag", "symbol": "tau", "first": [0.1, 0.01], "second": [0.2, 0.01], "same": same}
    row = {"findings": [], "only": {"first": [], "second": only}, "sizes": [size], "changed": changed, "named": [1, 1]}
    told = scored(PAIR, row, case="replication")
    assert (told["tier"], told["right"], told["empty"]) == ("replication", right, False)


def test_two_drives_that_show_nothing_replicate_nothing() -> None:
    nothing = {"findings": [], "only": {"first": [], "second": []}, "sizes": [], "changed": []}
    rows = [scored(PAIR, nothing | {"named": named}, case="replication") for named in ([0, 0], [1, 1], [0, 0])]
    assert [row["empty"] for row in rows] == [True, False, True]
    told = {f.figure: f for f in real_figures(rows)}
    assert told["replication: same names and sizes"].n == 1
    assert (told["replication: pairs without a name"].n, told["replication: pairs without a name"].value) == (3, 2)


def test_another_size_of_an_effect_of_the_first_drive_s_model_is_told_as_changed() -> None:
    symbols = ("motor_lag__tau", "K_t", "motor_dead_zone__width", "motor_lag__tau")
    row = {"findings": [], "other_figures": [{"symbol": s, "nats": 20.0} for s in symbols]}
    assert effects_of_figures(row) == ["motor_lag", "motor_dead_zone"]


@pytest.mark.parametrize(
    ("augmented", "base", "sindy", "below", "best"),
    [(0.1, 0.2, 0.3, True, True), (0.2, 0.2, 0.3, False, False), (0.1, 0.2, 0.05, True, False),
     (None, None, None, False, False), (0.1, None, None, True, True)],
)  # fmt: skip
def test_predictions_of_another_drive_are_compared_by_their_medians(
    augmented: float | None, base: float | None, sindy: float | None, below: bool, best: bool
) -> None:
    errors = {"augmented": augmented, "base": base, "k-sindy": sindy}
    told = scored(PAIR, {"errors": {name: {"median_m": m} for name, m in errors.items()}}, case="transfer")
    assert (told["tier"], told["below_base"], told["best"]) == ("transfer", below, best)


@pytest.mark.parametrize(
    ("again", "differs"),
    [
        (said(finding("motor_lag")), False),
        (said(finding("motor_lag", "rear_toe")), False),  # told as ambiguous, but the same name
        (said(finding("rear_toe")), True),
        (said(finding("motor_lag"), finding("rear_toe")), True),
        (said(), True),
        ({"verdict": "error", "findings": [], "error": "left the numbers"}, True),
    ],
)
def test_a_question_asked_from_another_start_has_the_same_answer(again: dict[str, Any], differs: bool) -> None:
    jobs = [
        Job("own", "take.csv", "lag", dict, question=LAG, beside=("whole",)),
        Job("again", "take.csv", "lag", dict, question=LAG, beside=("own",), variation=STARTS[0]),
    ]
    first, second = score_jobs(jobs, {"own": said(finding("motor_lag")), "again": again})
    assert (first["tier"], second["tier"], second["differs"]) == ("withheld", "start", differs)
    assert first.get("changes_with", []) == ([STARTS[0].name] if differs else [])


def test_what_failed_is_wrong_and_what_was_not_asked_is_no_row() -> None:
    jobs = [Job(key, "take.csv", key, dict, question=LAG, beside=("whole",)) for key in ("failed", "unasked")]
    (row,) = score_jobs(jobs, {"failed": {"verdict": "error", "findings": [], "error": "left the numbers"}})
    assert (row["case"], row["tier"], row["right"]) == ("failed", "withheld", False)


def rows_of_figures() -> list[dict[str, Any]]:
    withheld = [
        {"tier": "withheld", "right": right, "first": first, "false": false, "cpu_s_per_minute": 40.0}
        for right, first, false in ((True, True, []), (True, False, ["rear_toe"]), (False, False, ["motor_sag"]))
    ]
    failed = {"tier": "withheld", "right": False, "false": [], "error": "left the numbers"}
    starts = [{"tier": "start", "right": not d, "false": [], "differs": d} for d in (False, False, True)]
    return [*withheld, failed, {"tier": "control", "right": True, "false": []}, *starts]


def test_figures_are_counted_with_their_exact_intervals() -> None:
    figures = {f.figure: f for f in real_figures(rows_of_figures())}
    assert figures["withheld: questions with an answer"].value == 3
    right = figures["withheld: right"]
    assert (right.hits, right.n, right.value) == (2, 4, 0.5)
    assert right.ci95 == pytest.approx((0.0676, 0.9324), abs=1e-4)  # Clopper-Pearson of 2 in 4
    assert figures["withheld: named first"].hits == 1
    false = figures["withheld: false names a question"]
    assert false.value == pytest.approx(2 / 3)
    assert false.ci95 == pytest.approx((0.2422 / 3, 7.2247 / 3), abs=1e-4)  # Garwood of 2
    assert figures["another start: other answer"].value == pytest.approx(1 / 3)
    assert figures["transfer: augmented below base"].value is None
    assert figures["CPU seconds a minute of drive, median"].value == 40.0


def test_figures_outside_their_goals_are_told_and_those_of_nothing_miss_none() -> None:
    missed = {f.figure for f in with_goals(real_figures(rows_of_figures())) if f.missed}
    assert missed == {
        "withheld: questions with an answer", "withheld: right", "withheld: named first",
        "withheld: false names a question", "another start: other answer",
    }  # fmt: skip
    assert not any(f.missed for f in with_goals(real_figures([])))
    document = real_document(rows_of_figures(), "c0de")
    assert len(document.missed) == len(missed)
    assert json.loads(json.dumps(document.as_json()))["schema"] == "bcid.prove-real/2"
