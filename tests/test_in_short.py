"""What a page says first: how large findings are, what the error is made of, what is left, what to do, whence it is."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bcid.cli.options import command_line
from bcid.documents.diagnosis import (
    DiagnosisDocument,
    FitSummary,
    Mismatch,
    NamedEffect,
    NextManoeuvre,
    NotExcited,
    Quantity,
    UnknownPart,
)
from bcid.documents.error_budget import ErrorBudget, ErrorShare
from bcid.documents.model_card import DataFile, DataSpan, ModelCard, NoiseLevel
from bcid.recording.recorded_on import recorded_on
from bcid.report.before_after_figures import draw_before_after_pictures
from bcid.report.budget_words import EFFECT_COLOURS, budget_rows, percent_range
from bcid.report.diagnosis_page import write_diagnosis_page
from bcid.report.so_what import finding_sentences, next_sentences, remainder_sentences

NOTHING = {"time_s": np.empty(0), "start": np.empty(0)}
PLAY = NamedEffect(
    effect="steering_backlash", kind="vehicle", gain_nats=300.0,
    parameters={"b": Quantity(value=0.03, se=0.002, unit="rad")},
)  # fmt: skip
SLOPE = NamedEffect(
    effect="floor_slope", kind="environment", gain_nats=40.0,
    parameters={"g_x": Quantity(value=0.2, se=0.01, unit="m/s²"), "g_y": Quantity(value=0.0, se=0.01, unit="m/s²")},
)  # fmt: skip


def budget(play: float = 0.6, slope: float = 0.2, rest: float = 0.1, certain: bool = True) -> ErrorBudget:
    """A budget with two findings; what is unexplained is certainly there, or not."""
    parts = (
        ErrorShare(cause="effect", effects=("steering_backlash",), share=play, ci95=(play - 0.1, play + 0.1)),
        ErrorShare(cause="effect", effects=("floor_slope",), share=slope, ci95=(slope - 0.1, slope + 0.1)),
        ErrorShare(cause="noise", share=1.0 - play - slope - rest, ci95=(0.05, 0.15)),
        ErrorShare(cause="unexplained", share=rest, ci95=(0.05 if certain else -0.05, 0.15)),
    )
    return ErrorBudget(horizon_s=2.0, nmse=0.0123, parts=parts)


def document(**about: Any) -> DiagnosisDocument:
    return DiagnosisDocument(**({"verdict": "named", "findings": (SLOPE, PLAY), "error_budget": budget()} | about))


def card() -> ModelCard:
    """The card of a model whose take has a name that could be taken for an element of the page."""
    return ModelCard(
        vehicle="car", vehicle_file=DataFile(name="car.toml", sha256="ab" * 32), command="bcid diagnose take.csv",
        data=(DataFile(name="<take>.csv", sha256="cd" * 32, recorded="2026-01-01 12.00.00.000 AM"),), duration_s=60.0,
        made="2026-11-28T12:20:11Z", program="bcid 0.1.0", model="newton-euler-augmented", period_s=0.1,
        noise=(NoiseLevel(name="position x", value=0.0021, unit="m"), NoiseLevel(name="yaw", value=0.004, unit="rad")),
        spans=(DataSpan(quantity="v_x", unit="m/s", low=-0.3, high=1.5),), not_for=("Another car.",),
    )  # fmt: skip


def test_findings_are_told_in_everyday_words_the_largest_share_first() -> None:
    play, slope = finding_sentences(document())
    assert play.startswith("The steering has 1.72 ± 0.11° of play to either side.")
    assert "60 % of the error (95 % interval 50 to 70 %)" in play
    assert slope.startswith("A floor that falls by 2.04 ± 0.10 cm on each metre")


def test_a_finding_that_does_not_show_in_the_error_is_not_said_to_make_any() -> None:
    _, slope = finding_sentences(document(error_budget=budget(slope=-0.01)))
    assert "takes next to nothing off the error" in slope
    assert "it makes the recorded poses more than a million times likelier" in slope
    assert "nats" not in slope
    assert "−1.0 %" not in slope


def test_without_a_budget_only_sizes_are_told() -> None:
    sentences = finding_sentences(document(error_budget=None))
    assert len(sentences) == 2
    assert not any("error" in s for s in sentences)


def test_what_is_left_is_said_only_where_it_is_certain() -> None:
    assert "10 % of the error (95 % interval 5.0 to 15 %) stay unexplained." in remainder_sentences(document())
    (sentence,) = remainder_sentences(document(error_budget=budget(certain=False)))
    assert sentence.startswith("Nothing of the error is left for certain")


def test_where_the_noise_is_not_known_nothing_is_said_to_stay_unexplained() -> None:
    """A car that cannot be simulated for the whole take leaves no floor: the rest is no lack of the model's."""
    parts = (
        ErrorShare(cause="effect", effects=("steering_backlash",), share=0.6, ci95=(0.5, 0.7)),
        ErrorShare(cause="left-noise-included", share=0.4, ci95=(0.3, 0.5)),
    )
    (sentence,) = remainder_sentences(document(error_budget=ErrorBudget(horizon_s=2.0, nmse=0.01, parts=parts)))
    assert sentence.startswith("40 % of the error (95 % interval 30 to 50 %) are left, noise included")
    assert "unexplained" not in sentence
    assert budget_rows(ErrorBudget(horizon_s=2.0, nmse=0.01, parts=parts))[-1].label == "left, noise included"


def test_where_something_has_no_name_the_errors_are_said_to_be_too_small() -> None:
    unknown = UnknownPart(channel="mz", depends_on=("yaw_rate",))
    text = " ".join(remainder_sentences(document(unknown=unknown)))
    assert "yaw moment (mz), with the yaw rate: so ± are too small" in text


def test_what_to_do_next_names_deeds_drives_and_what_was_not_shown() -> None:
    drive = NextManoeuvre(name="circle", file="next.csv", repeats=2, separates=("steering_delay", "steering_lag"))
    unseen = tuple(NotExcited(effect=e) for e in ("yaw_scrub", "load_transfer", "tether_pull", "motor_sag"))
    text = " ".join(next_sentences(document(next_manoeuvre=drive, not_excited=unseen)))
    assert "For steering backlash: mend the car" in text
    assert "For floor slope: change the floor there" in text
    assert "Drive circle 2 times" in text
    assert "tells steering delay and steering lag apart" in text
    assert "This drive hardly excites yaw scrub, load transfer, tether pull and 1 more, and shows them only if" in text
    assert "bcid plan yaw_scrub load_transfer tether_pull --vehicle" in text


def test_twins_without_a_drive_are_to_be_told_apart() -> None:
    twin = PLAY.model_copy(update={"twins": ("steering_dead_band",)})
    text = " ".join(next_sentences(document(findings=(twin,), verdict="ambiguous")))
    assert text.startswith("Drive what tells steering backlash from steering dead band")
    assert "mend" not in text, "nobody knows yet what it is"
    (finding,) = finding_sentences(document(findings=(twin,), error_budget=None))
    assert finding.endswith("to either side, or it is steering dead band instead.")


def test_where_nothing_is_missing_nothing_needs_to_be_mended() -> None:
    (sentence,) = next_sentences(DiagnosisDocument(verdict="nothing-found"))
    assert sentence.startswith("Nothing needs to be mended")
    assert next_sentences(DiagnosisDocument(verdict="nothing-found", mismatch=Mismatch(detected=True))) == []


def test_an_error_that_stays_above_the_noise_is_not_said_to_be_all_noise() -> None:
    high, low = (FitSummary(horizon_s=2.0, nmse_before=before, nmse_floor=0.002) for before in (0.006, 0.0021))
    nothing = {"verdict": "nothing-found", "findings": (), "error_budget": budget(0.0, 0.0, 0.6, certain=False)}
    assert next_sentences(document(**nothing, fit=high)) == []
    assert remainder_sentences(document(**nothing, fit=high)) == [
        "Of the error 60 % are left above the noise floor, which chance may make."
    ]
    assert next_sentences(document(**nothing, fit=low))[0].startswith("Nothing needs to be mended")
    assert remainder_sentences(document(**nothing, fit=low))[0].startswith("Nothing of the error is left")


def test_what_no_error_shows_but_poses_do_is_told_as_such() -> None:
    unknown = UnknownPart(channel="pose", gain_nats=97.0)
    error, rest = remainder_sentences(document(unknown=unknown, error_budget=budget(certain=False)))
    assert error.startswith("Nothing of the error is left for certain")
    assert rest.startswith("In the recorded poses, which show more than this error does, something without a name")
    _, rest = remainder_sentences(document(unknown=unknown))
    assert rest.startswith("Something without a name still acts on the tracked pose")


def test_the_bar_and_the_table_hold_every_part() -> None:
    rows = budget_rows(budget())
    assert [r.label for r in rows] == ["steering backlash", "floor slope", "noise of the poses", "unexplained"]
    assert [r.share for r in rows] == ["60 %", "20 %", "10 %", "10 %"]
    assert [r.remark for r in rows] == ["", "", "", ""]

    assert len({r.colour for r in rows}) == 4
    assert rows[0].colour == EFFECT_COLOURS[0]
    assert percent_range(-0.002, 0.5) == "−0.2 to 50 %"
    lengths = [r.length for r in budget_rows(budget(slope=-0.05, rest=0.2))]
    assert lengths[1] == 0.0
    assert sum(lengths) == pytest.approx(100.0)


def test_a_share_that_may_be_nothing_is_said_to_be_so(tmp_path: Path) -> None:
    shares = ((-0.012, (-0.03, 0.01)), (-0.05, (-0.08, -0.02)), (1.062, (0.9, 1.1)))
    parts = tuple(ErrorShare(cause="effect", effects=("floor_slope",), share=s, ci95=ci95) for s, ci95 in shares)
    told = ErrorBudget(horizon_s=2.0, nmse=0.01, parts=parts)
    remarks = ["not distinguishable from nothing", "makes the error larger", ""]
    assert [r.remark for r in budget_rows(told)] == remarks
    write_diagnosis_page(document(error_budget=told), NOTHING, NOTHING, tmp_path / "page.html")
    page = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert all(page.count(remark) == 1 for remark in remarks if remark)


def test_the_page_holds_budget_and_card(tmp_path: Path) -> None:
    assert ModelCard.from_json(card().model_dump_json(by_alias=True)) == card()
    path = tmp_path / "page.html"
    write_diagnosis_page(document(), NOTHING, NOTHING, path, card())
    text = path.read_text(encoding="utf-8")
    shown = [
        "What the 2 s error is made of", "12.30 × 10⁻³", "50 to 70 %", "abababab", "&lt;take&gt;.csv",
        "2026-11-28 12:20:11 UTC", "bcid diagnose take.csv", "forward speed (m/s)", "Another car.",
    ]  # fmt: skip
    assert [part for part in shown if part not in text] == []
    write_diagnosis_page(document(), NOTHING, NOTHING, path)
    assert "Model card" not in path.read_text(encoding="utf-8")


def tracks(before: np.ndarray[Any, Any], after: np.ndarray[Any, Any]) -> dict[str, np.ndarray[Any, Any]]:
    """Tracks of a straight drive of 100 s that are `before` and `after` (K,) m to the left of the measured one."""
    time, x = np.arange(1000) / 10.0, np.arange(1000) / 20.0
    zero, start = np.zeros(1000), (np.arange(1000) % 20 == 0).astype(float)
    return {
        "time_s": time, "x": x, "y": zero, "before_x": x, "before_y": before, "after_x": x, "after_y": after,
        "start": start,
    }  # fmt: skip


def test_paths_are_shown_where_the_finding_helps_most_and_not_where_the_base_model_is_worst() -> None:
    time = np.arange(1000) / 10.0
    worst, helped = (time >= 20.0) & (time < 40.0), (time >= 60.0) & (time < 80.0)
    before, after = np.where(worst, 0.5, np.where(helped, 0.3, 0.01)), np.where(worst, 0.49, 0.01)
    (picture,) = draw_before_after_pictures(document(), NOTHING, tracks(before, after))
    assert picture.title == "Predicted paths where what was found helps most"
    assert "The 20 s from 60 s on" in picture.caption
    assert "falls from 30 to 1 cm, in the whole recording from 26 to 22 cm" in picture.caption
    (picture,) = draw_before_after_pictures(document(), NOTHING, tracks(before, before))
    assert "The 20 s from 20 s on, where the base model misses most" in picture.caption


def test_the_command_line_names_no_user_s_folder(monkeypatch: pytest.MonkeyPatch) -> None:
    words = ["/usr/bin/bcid", "diagnose", str(Path.home() / "my takes" / "a.csv"), "--out", "w"]
    monkeypatch.setattr(sys, "argv", words)
    assert command_line() == "bcid diagnose ~/'my takes/a.csv' --out w"


def test_a_motive_export_says_when_it_was_captured(tmp_path: Path) -> None:
    path = tmp_path / "take.csv"
    path.write_text("Format Version,1.24,Capture Start Time,2026-01-01 12.00.00.000 AM,Total,3\nrow\n")
    assert recorded_on(path) == "2026-01-01 12.00.00.000 AM"
    path.write_text("time_s,x,y\n0,0,0\n")
    assert recorded_on(path) is None


def test_an_mcap_file_says_when_its_first_message_was_logged(tmp_path: Path) -> None:
    from mcap.writer import Writer

    path = tmp_path / "take.mcap"
    for seconds, expected in ((1_767_225_600, "2026-01-01 00:00 UTC"), (12, None)):
        with path.open("wb") as file:
            writer = Writer(file)
            writer.start()
            channel = writer.register_channel("/pose", "json", writer.register_schema("pose", "jsonschema", b"{}"))
            writer.add_message(channel, seconds * 10**9, b"{}", seconds * 10**9)
            writer.finish()
        assert recorded_on(path) == expected
    path.write_bytes(path.read_bytes()[:60])
    assert recorded_on(path) is None
