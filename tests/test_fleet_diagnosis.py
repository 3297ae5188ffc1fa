"""What the diagnoses of a fleet's logs say together: effects since a day, parameters that moved, words and page."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from bcid.documents.diagnosis import BaseModel, BaseParameter, DiagnosisDocument, NamedEffect, Quantity, Rival
from bcid.documents.fleet import FleetDocument, FleetLog
from bcid.errors import InputRefused
from bcid.fleet.labels import LogLabel, label_logs
from bcid.fleet.log_evidence import LogEvidence
from bcid.fleet.moved import fit_days, reject_at_false_share
from bcid.fleet.occurrences import Occurrence, find_occurrences
from bcid.fleet.together import DiagnosedLog, diagnose_together
from bcid.report.fleet_page import write_fleet_page
from bcid.report.fleet_words import fleet_sentences

DAYS = [0, 0, 0, 0, 1, 1, 1, 1, 2, 2, 2, 2]
UNKNOWN_CARS = [""] * len(DAYS)
HAVING = (5, 6, 9, 11)
QUIET = dict.fromkeys((f"effect_{i}" for i in range(40)), -2.0)


def log(named: dict[str, float] | None = None, **others: float) -> LogEvidence:
    """The evidence of a log, in which effects that are not given add nothing."""
    named = named or {}
    return LogEvidence(named, {k: v for k, v in (QUIET | others).items() if k not in named}, {})


def fleet(having: LogEvidence, lacking: LogEvidence | None = None) -> list[LogEvidence]:
    """Twelve logs, of which those in HAVING have an effect."""
    return [having if i in HAVING else lacking or log() for i in range(len(DAYS))]


def find_one(logs: list[LogEvidence], cars: list[str] | None = None) -> Occurrence:
    """The one effect that logs show."""
    (found,) = find_occurrences(logs, DAYS, cars or UNKNOWN_CARS)
    return found


def test_an_effect_since_a_day_is_found_with_its_share_and_its_logs() -> None:
    found = find_one(fleet(log({"effect_3": 40.0})))
    assert (found.effect, found.day) == ("effect_3", 1)
    assert found.day_probability > 0.8
    assert found.share_interval[0] < 0.5 < found.share_interval[1]
    assert [i for i, p in enumerate(found.in_logs) if p > 0.5] == list(HAVING)


def test_what_no_log_shows_by_itself_several_show_together() -> None:
    assert find_one(fleet(log(effect_3=8.0))).effect == "effect_3"


@pytest.mark.parametrize("nats", [8.0, 1000.0])
def test_a_single_log_is_no_evidence_for_a_fleet(nats: float) -> None:
    logs = [log({"effect_3": nats}), *[log()] * (len(DAYS) - 1)]
    assert not find_occurrences(logs, DAYS, UNKNOWN_CARS)


def test_logs_that_show_one_effect_each_show_none_together() -> None:
    logs = [log({f"effect_{i}": 30.0}) for i in range(len(DAYS))]
    assert not find_occurrences(logs, DAYS, UNKNOWN_CARS)


def test_chance_in_every_log_is_no_effect() -> None:
    rng = np.random.default_rng(5)
    told = 0
    for _ in range(40):
        # half the square of a normal number, less what a parameter costs
        chance = [dict(zip(QUIET, 0.5 * rng.normal(size=40) ** 2 - 2.0, strict=True)) for _ in DAYS]
        told += bool(find_occurrences([LogEvidence({}, c, {}) for c in chance], DAYS, UNKNOWN_CARS))
    assert told <= 1


def test_an_effect_of_all_days_is_not_since_a_later_one() -> None:
    found = find_one([log({"effect_3": 20.0})] * len(DAYS))
    assert found.day == 0
    assert found.share > 0.9


def test_of_two_effects_that_explain_the_same_the_likelier_in_all_logs_is_told_and_the_other_never_a_second_time() -> (
    None
):
    close = log(effect_3=12.0, effect_4=11.0)
    apart = log(effect_3=12.0, effect_4=2.0)
    found = find_one([apart if i in HAVING[:3] else close if i in HAVING else log() for i in range(len(DAYS))])
    assert found.effect == "effect_3"
    assert not found.twins
    assert find_one(fleet(close)).twins == ("effect_4",)


def test_a_log_that_names_the_rival_still_counts_for_what_the_others_show() -> None:
    mistaken = LogEvidence(
        {"effect_4": 20.0}, {k: v for k, v in QUIET.items() if k != "effect_4"}, {("effect_4", "effect_3"): 18.0}
    )
    logs = fleet(log({"effect_3": 20.0}))
    logs[HAVING[0]] = mistaken
    found = find_one(logs)
    assert found.effect == "effect_3"
    assert found.in_logs[HAVING[0]] > 0.5


def test_two_effects_that_logs_name_beside_each_other_are_both_found() -> None:
    found = find_occurrences(fleet(log({"effect_3": 30.0, "effect_4": 25.0})), DAYS, UNKNOWN_CARS)
    assert {f.effect for f in found} == {"effect_3", "effect_4"}


def test_where_the_cars_are_known_the_logs_of_one_stand_together() -> None:
    cars = ["a", "b", "c", "c"] * 3
    # the car a has it from the second day on, but one of its logs hardly shows it
    logs = [log({"effect_3": 30.0}) if c == "a" and d else log() for c, d in zip(cars, DAYS, strict=True)]
    in_one = find_occurrences(logs, DAYS, cars)
    logs = [log(effect_3=9.0) if c in "ab" and d else log() for c, d in zip(cars, DAYS, strict=True)]
    logs[4] = log(effect_3=0.0)
    found = find_one(logs, cars)
    assert not in_one or in_one[0].in_logs[0] < 0.5
    assert found.day == 1
    assert found.in_logs[4] > 0.5 > found.in_logs[6]


def test_a_parameter_that_moved_is_told_with_an_interval_that_holds() -> None:
    rng = np.random.default_rng(3)
    held, false_alarms, repeats = 0, 0, 200
    for _ in range(repeats):
        se = rng.uniform(0.01, 0.03, len(DAYS))
        x = 2.0 + 0.1 * (np.array(DAYS) >= 2) + rng.normal(0.0, 0.02, len(DAYS)) + rng.normal(0.0, se)
        model = fit_days(x, se, DAYS, UNKNOWN_CARS)
        assert model is not None
        second, third = model.changes
        held += abs(third.change - 0.1) < third.half_width
        false_alarms += second.p_value < 0.05
    assert 0.91 < held / repeats < 0.985
    assert false_alarms / repeats < 0.09


def test_cars_differ_without_a_day_being_another() -> None:
    rng = np.random.default_rng(8)
    cars = ["a", "b", "a", "a", "b", "b", "b", "a", "b", "b", "b", "a"]
    x = np.array([{"a": 1.0, "b": 3.0}[c] for c in cars]) + rng.normal(0.0, 0.02, len(cars))
    with_cars = fit_days(x, np.full(len(x), 0.02), DAYS, cars)
    without = fit_days(x, np.full(len(x), 0.02), DAYS, UNKNOWN_CARS)
    assert with_cars is not None
    assert without is not None
    assert all(abs(change.change) < 0.1 for change in with_cars.changes)
    assert without.tau > 10.0 * with_cars.tau


def test_too_few_logs_for_a_comparison_give_none() -> None:
    assert fit_days(np.array([1.0, 2.0]), np.array([0.1, 0.1]), [0, 1], ["", ""]) is None
    assert fit_days(np.array([1.0, 2.0]), np.array([0.1, 0.1]), [0, 0], ["", ""]) is None


def test_false_rejections_are_few_among_many_hypotheses() -> None:
    rng = np.random.default_rng(2)
    shares = []
    for _ in range(300):
        p = np.r_[rng.uniform(size=90), 1e-4 * rng.uniform(size=10)]
        told = np.array(reject_at_false_share(p.tolist(), 0.05))
        shares.append(told[:90].sum() / max(told.sum(), 1))
    assert np.mean(shares) < 0.07
    assert reject_at_false_share([], 0.05) == []


@pytest.mark.parametrize(
    ("paths", "days"),
    [
        (["a/Take 2026-11-28 10.01.02 AM.csv", "a/take_20261129.mcap"], ["2026-11-28", "2026-11-29"]),
        (["2026_11_28/one.csv", "2026_11_29/one.csv"], ["2026-11-28", "2026-11-29"]),
        (["monday/one.csv", "tuesday/one.csv"], ["monday", "tuesday"]),
        (["one.csv", "two.csv"], ["", ""]),
        (["a/2026-11-28.csv", "b/other.csv"], ["a", "b"]),
    ],
)
def test_days_are_read_from_names_and_folders(tmp_path: Path, paths: list[str], days: list[str]) -> None:
    labels = label_logs([tmp_path / p for p in paths], [Path(p).stem for p in paths])
    assert [label.day for label in labels] == days


def test_a_table_says_day_and_car(tmp_path: Path) -> None:
    table = tmp_path / "fleet.csv"
    table.write_text("log,day,car\none.csv,2026-11-28,red\ntwo,2026-11-29,blue\n", encoding="utf-8")
    labels = label_logs([tmp_path / "one.csv", tmp_path / "two.csv"], ["one", "two"], table)
    assert labels == [LogLabel("2026-11-28", "red"), LogLabel("2026-11-29", "blue")]


@pytest.mark.parametrize(
    ("text", "cause"),
    [
        ("log,car\none,red\n", "no column day"),
        ("log,day\none,\n", "line 2"),
        ("log,day\none,a\none,b\n", "line 3"),
        ("log,day\none,a\n", "nothing of two"),
        ("", "no column log"),
    ],
)
def test_a_table_that_says_too_little_is_refused(tmp_path: Path, text: str, cause: str) -> None:
    table = tmp_path / "fleet.csv"
    table.write_text(text, encoding="utf-8")
    with pytest.raises(InputRefused, match=cause):
        label_logs([tmp_path / "one.csv", tmp_path / "two.csv"], ["one", "two"], table)


def diagnosed(i: int, K_t: float) -> DiagnosedLog:
    """One of twelve logs, with a motor constant; those in HAVING have a slope."""
    findings = (
        NamedEffect(effect="floor_slope", gain_nats=30.0, parameters={"g": Quantity(value=0.06, se=0.004, unit="1")}),
    )
    rivals = (Rival(effects=("rough_patch",), behind_nats=12.0),)
    document = DiagnosisDocument(
        verdict="named" if i in HAVING else "nothing-found", findings=findings if i in HAVING else (),
        rivals=rivals if i in HAVING else (), others_nats=QUIET if i in HAVING else QUIET | {"floor_slope": -2.0},
        base=BaseModel(parameters=(BaseParameter(symbol="K_t", value=K_t, se=0.02, unit="kg s^-1"),)),
    )  # fmt: skip
    return DiagnosedLog(f"log_{i}", LogLabel(f"2026-11-{28 + DAYS[i]}"), document)


def test_diagnoses_are_put_into_words_and_on_a_page(tmp_path: Path) -> None:
    rng = np.random.default_rng(4)
    logs = [diagnosed(i, 2.0 * (1.1 if DAYS[i] == 2 else 1.0) + 0.02 * rng.normal()) for i in range(len(DAYS))]
    together = diagnose_together(logs)
    assert together is not None
    assert [e.effect for e in together.effects] == ["floor_slope"]
    (moved,) = together.moved
    assert (moved.symbol, moved.day, moved.beside) == ("K_t", "2026-11-30", "2026-11-28")
    assert moved.ci95[0] < 0.1 < moved.ci95[1]
    assert [p.symbol for p in together.parameters] == ["K_t", "floor_slope.g"]
    rows = tuple(FleetLog(name=x.name, file=x.name, state="done", day=x.label.day) for x in logs)
    document = FleetDocument(vehicle="car", models=("newton-euler",), diagnosed=True, logs=rows, together=together)
    first, second, third = fleet_sentences(document)
    assert first.startswith("Floor slope is there since 2026-11-29")
    assert second == "2026-11-29: the car of 2026-11-28, but for floor slope."
    assert third.startswith("2026-11-30: the car of 2026-11-28, but for K_t +")
    page = tmp_path / "fleet.html"
    write_fleet_page(document, page)
    text = page.read_text(encoding="utf-8")
    assert text.count("<svg") == 3  # the effect's logs, and a strip each for K_t and the slope
    document.write(tmp_path / "fleet.json")
    assert FleetDocument.read(tmp_path / "fleet.json") == document


def test_a_log_that_cannot_say_is_not_listed() -> None:
    logs = [diagnosed(i, 2.0) for i in range(len(DAYS))]
    silent = logs[0].document.model_copy(update={"others_nats": QUIET})
    together = diagnose_together([logs[0]._replace(document=silent), *logs[1:]])
    assert together is not None
    assert sorted(together.effects[0].in_logs) == sorted(f"log_{i}" for i in range(1, len(DAYS)))


def test_one_diagnosed_log_says_nothing_of_a_fleet() -> None:
    assert diagnose_together([diagnosed(0, 2.0)]) is None
