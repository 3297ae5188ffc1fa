"""What the diagnoses of a fleet's logs say together: effects since a day, parameters that moved, words and page."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bcid.documents.diagnosis import REFITTED, BaseModel, BaseParameter, DiagnosisDocument, NamedEffect, Quantity, Rival
from bcid.documents.fleet import FleetDocument, FleetLog, MovedParameter
from bcid.effects.table import EFFECTS
from bcid.errors import InputRefused
from bcid.fleet.labels import LogLabel, label_logs
from bcid.fleet.log_evidence import LogEvidence
from bcid.fleet.moved import _Design, fit_days, reject_at_false_share
from bcid.fleet.occurrences import Occurrence, _weigh_against, find_occurrences
from bcid.fleet.together import DiagnosedLog, diagnose_together
from bcid.report.fleet_page import write_fleet_page
from bcid.report.fleet_words import change_in_words, fleet_sentences

ALL_DAYS = ("2026-11-28", "2026-11-29", "2026-11-30")
DAYS = [0, 0, 0, 0, 1, 1, 1, 1, 2, 2, 2, 2]
UNKNOWN_CARS = [""] * len(DAYS)
HAVING = (5, 6, 9, 11)
EFFECT, RIVAL, *REST = [name for name in EFFECTS if len(EFFECTS[name].parameters) == 1]
QUIET = dict.fromkeys((EFFECT, RIVAL, *REST), -2.0)


def log(named: dict[str, float] | None = None, **others: float) -> LogEvidence:
    """The evidence of a log of 64 stretches, in which effects that are not given add nothing.

    It is expected to show 25 nats of an effect of the size 1, which each has that it names.
    """
    named = named or {}
    rest = {k: v for k, v in (QUIET | others).items() if k not in named}
    return LogEvidence(named, rest, {}, 64, frozenset(), _sizes(named, 1.0), _sizes(QUIET, 0.2))


def _sizes(effects: Iterable[str], size: float) -> dict[str, dict[str, float]]:
    """The one parameter of each effect at the same size."""
    return {name: {p.symbol: size for p in EFFECTS[name].parameters} for name in effects}


def fleet(having: LogEvidence, lacking: LogEvidence | None = None) -> list[LogEvidence]:
    """Twelve logs, of which those in HAVING have an effect."""
    return [having if i in HAVING else lacking or log() for i in range(len(DAYS))]


def find_one(logs: list[LogEvidence], cars: list[str] | None = None) -> Occurrence:
    """The one effect that logs show."""
    (found,) = find_occurrences(logs, DAYS, cars or UNKNOWN_CARS)
    return found


@pytest.mark.parametrize("nats", [20.0, 800.0])
def test_an_effect_since_a_day_is_found_with_its_share_and_its_logs(nats: float) -> None:
    found = find_one(fleet(log({EFFECT: nats})))
    assert (found.effect, found.day, found.twins) == (EFFECT, 1, ())
    assert found.day_probability > 0.8
    assert found.share_interval[0] < 0.5 < found.share_interval[1]
    assert found.share == pytest.approx(0.5, abs=0.06)
    assert float(found.in_logs.sum()) == pytest.approx(4.0, abs=0.5)
    assert [i for i, p in enumerate(found.in_logs) if p > 0.5] == list(HAVING)


def test_what_no_log_shows_by_itself_several_show_together() -> None:
    assert find_one(fleet(log(**{EFFECT: 8.0}))).effect == EFFECT


def test_the_docs_say_how_much_a_log_counts() -> None:
    text = (Path(__file__).parents[1] / "docs" / "fleet.md").read_text(encoding="utf-8").replace("−", "-")
    rows = re.findall(r"^\| (?:it|a drive).* \| (-?\d+) \| ([-+]?[\d.]+) \|$", text, re.MULTILINE)
    assert len(rows) == 5
    for nats, counts in rows:
        assert _weigh_against(float(nats), max(float(nats), 0.0), 0.0, 0.0) == pytest.approx(float(counts), abs=0.05)


@pytest.mark.parametrize("nats", [8.0, 1000.0])
def test_a_single_log_is_no_evidence_for_a_fleet(nats: float) -> None:
    logs = [log({EFFECT: nats}), *[log()] * (len(DAYS) - 1)]
    assert not find_occurrences(logs, DAYS, UNKNOWN_CARS)


def test_two_logs_among_many_that_cannot_say_are_not_enough() -> None:
    silent = LogEvidence({}, {k: v for k, v in QUIET.items() if k != EFFECT}, {}, 64)
    found = find_occurrences([log({EFFECT: 30.0})] * 2 + [log()] * 2 + [silent] * 8, DAYS, UNKNOWN_CARS)
    assert not found


def test_logs_that_show_one_effect_each_show_none_together() -> None:
    logs = [log({name: 30.0}) for name in REST[: len(DAYS)]]
    assert not find_occurrences(logs, DAYS, UNKNOWN_CARS)


def test_chance_in_every_log_is_no_effect() -> None:
    rng = np.random.default_rng(5)
    told = 0
    for _ in range(40):
        # half the square of a normal number, less what a parameter costs; of some effects a log says nothing
        chance = [
            {name: 0.5 * rng.normal() ** 2 - 2.0 for name in QUIET if rng.random() < 0.8} for _ in DAYS
        ]  # fmt: skip
        told += bool(find_occurrences([LogEvidence({}, c, {}, 64) for c in chance], DAYS, UNKNOWN_CARS))
    assert told <= 1


def test_an_effect_of_all_days_is_not_since_a_later_one() -> None:
    found = find_one([log({EFFECT: 20.0})] * len(DAYS))
    assert found.day == 0
    assert found.share > 0.9


def test_of_two_that_stand_for_each_other_the_likelier_in_all_logs_is_found_and_the_other_never_a_second_time() -> None:
    close, apart = log(**{EFFECT: 12.0, RIVAL: 11.0}), log(**{EFFECT: 12.0, RIVAL: 2.0})
    found = find_one([apart if i in HAVING[:3] else close if i in HAVING else log() for i in range(len(DAYS))])
    assert (found.effect, found.twins) == (EFFECT, ())
    assert find_one(fleet(close)).twins == (RIVAL,)


@pytest.mark.parametrize("nats", [40.0, 400.0, 800.0])
def test_a_listed_rival_of_what_is_certain_is_no_second_effect(nats: float) -> None:
    others = {k: v for k, v in QUIET.items() if k != EFFECT}
    sure = LogEvidence({EFFECT: nats}, others, {(EFFECT, RIVAL): nats - 20.0}, 64)
    assert find_one(fleet(sure)).effect == EFFECT


def test_a_log_that_names_the_rival_still_counts_for_what_the_others_show() -> None:
    others = {k: v for k, v in QUIET.items() if k != RIVAL}
    logs = fleet(log({EFFECT: 20.0}))
    logs[HAVING[0]] = LogEvidence({RIVAL: 20.0}, others, {(RIVAL, EFFECT): 18.0}, 64)
    found = find_one(logs)
    assert found.effect == EFFECT
    assert found.in_logs[HAVING[0]] > 0.5


@pytest.mark.parametrize(("one", "other"), [(30.0, 29.0), (30.0, 25.0), (60.0, 12.0)])
def test_two_effects_that_logs_name_beside_each_other_are_both_found(one: float, other: float) -> None:
    found = find_occurrences(fleet(log({EFFECT: one, RIVAL: other})), DAYS, UNKNOWN_CARS)
    assert {f.effect for f in found} == {EFFECT, RIVAL}
    assert not any(f.twins for f in found)


def test_two_effects_in_different_logs_are_both_found_each_in_its_own() -> None:
    logs = [log({EFFECT: 30.0}) if 4 <= i < 8 else log({RIVAL: 30.0}) if i >= 8 else log() for i in range(len(DAYS))]
    found = {f.effect: f for f in find_occurrences(logs, DAYS, UNKNOWN_CARS)}
    assert set(found) == {EFFECT, RIVAL}
    assert [i for i, p in enumerate(found[RIVAL].in_logs) if p > 0.5] == [8, 9, 10, 11]
    assert found[RIVAL].day == 2
    assert not any(f.twins for f in found.values())


@pytest.mark.parametrize("behind", [5.0, 20.0, 1000.0])
def test_of_two_effects_in_different_logs_each_speaks_against_the_other_where_that_is_its_listed_rival(
    behind: float,
) -> None:
    def sure_of(one: str, other: str) -> LogEvidence:
        rest = {k: v for k, v in QUIET.items() if k != one}
        return LogEvidence({one: 30.0}, rest, {(one, other): 30.0 - behind}, 64)

    logs = [
        sure_of(EFFECT, RIVAL) if 4 <= i < 8 else sure_of(RIVAL, EFFECT) if i >= 8 else log() for i in range(len(DAYS))
    ]
    found = {f.effect: f for f in find_occurrences(logs, DAYS, UNKNOWN_CARS)}
    assert set(found) == {EFFECT, RIVAL}
    assert not any(f.twins for f in found.values())
    assert found[RIVAL].day == 2
    assert [i for i, p in enumerate(found[RIVAL].in_logs) if p > 0.5] == [8, 9, 10, 11]
    assert [i for i, p in enumerate(found[EFFECT].in_logs) if p > 0.5] == [4, 5, 6, 7]
    assert found[RIVAL].in_logs[4:8].max() < 0.1


def test_what_logs_show_beside_a_finding_counts_whatever_could_stand_in_the_finding_s_place() -> None:
    """All logs have one effect and its twin; three name another one, and nine show it, too little to name it."""
    other = REST[0]

    def both(named: bool) -> LogEvidence:
        rest = {k: v for k, v in QUIET.items() if k not in (EFFECT, other)}
        findings = {EFFECT: 30.0} | ({other: 12.0} if named else {})
        return LogEvidence(findings, rest | ({} if named else {other: 8.0}), {(EFFECT, RIVAL): 29.9}, 64)

    found = {f.effect: f for f in find_occurrences([both(i < 3) for i in range(len(DAYS))], DAYS, UNKNOWN_CARS)}
    assert set(found) == {EFFECT, other}
    assert found[EFFECT].twins == (RIVAL,)
    assert found[other].in_logs.min() > 0.9


def test_few_of_those_that_are_reported_are_false_and_the_order_of_logs_does_not_matter() -> None:
    """Whatever is reported holds beside all else that is."""
    rng = np.random.default_rng(0)
    names = [EFFECT, RIVAL, *REST[:2]]
    for _ in range(60):
        logs = []
        for _ in range(8):
            finding = names[int(rng.integers(3))] if rng.random() < 0.6 else None
            named = {finding: float(rng.uniform(8.0, 30.0))} if finding else {}
            others = {k: float(rng.normal(0.0, 3.0)) for k in names if k != finding}
            instead = {
                (finding, k): named[finding] - float(rng.uniform(0.0, 15.0))
                for k in names if finding and k != finding and rng.random() < 0.6
            }  # fmt: skip
            logs.append(LogEvidence(named, others, instead, 64))
        found = find_occurrences(logs, [0] * 8, [""] * 8)
        false = np.cumsum([1.0 - f.probability for f in found])
        assert (false <= 0.05 * np.arange(1, len(found) + 1)).all()
        again = find_occurrences(logs[::-1], [0] * 8, [""] * 8)
        assert [f.effect for f in again] == [f.effect for f in found]


def test_what_is_named_beside_something_that_only_one_log_has_counts_in_full() -> None:
    logs = fleet(log())
    for i, once in zip(HAVING, REST, strict=False):
        logs[i] = log({EFFECT: 30.0, once: 60.0})
    assert find_one(logs).effect == EFFECT


SYMBOL = next(p.symbol for p in EFFECTS[EFFECT].parameters)


def shown(nats: float, expected: float, named: bool = False) -> LogEvidence:
    """A log whose drive is expected to show so many nats of an effect of the size 1, and shows `nats` of it."""
    evidence = log({EFFECT: nats}) if named else log(**{EFFECT: nats})
    return replace(evidence, nat_sizes=_sizes([EFFECT], expected**-0.5))


def test_a_log_that_shows_much_less_than_it_should_speaks_against_an_effect() -> None:
    assert shown(-2.0, 200.0).at_size(-2.0, EFFECT, {SYMBOL: 1.0}) < -50.0
    assert shown(180.0, 200.0).at_size(180.0, EFFECT, {SYMBOL: 1.0}) == pytest.approx(180.0, abs=1.0)
    # of what it does not say how well it shows it
    assert replace(log(), nat_sizes={}).at_size(-2.0, EFFECT, {SYMBOL: 1.0}) == -2.0


def test_a_short_log_is_not_expected_to_say_what_a_long_one_does() -> None:
    """Four logs name the effect; four short ones show as much of it as so short a log can."""
    found = find_occurrences([shown(150.0, 150.0, True)] * 4 + [shown(6.0, 7.5)] * 4, [0] * 8, [""] * 8)
    assert [f.effect for f in found] == [EFFECT]
    assert found[0].in_logs.min() > 0.9
    without = find_occurrences([shown(150.0, 150.0, True)] * 4 + [shown(-2.0, 7.5)] * 4, [0] * 8, [""] * 8)
    assert without[0].in_logs[4:].max() < 0.2


@pytest.mark.parametrize("gentle", [0.05, 0.5, 1.0, 3.0, 6.0, 8.0, 10.0])
def test_gentle_drives_do_not_count_against_what_they_hardly_show(gentle: float) -> None:
    """All logs have the effect; those of the first day, and some later ones, are driven gently."""
    # its price taken off
    nats = gentle - 2.0
    logs = [shown(200.0, 200.0, True) if i in (4, 5, 8, 9) else shown(nats, gentle) for i in range(len(DAYS))]
    found = find_one(logs)
    assert found.share > 0.75
    assert not (found.day > 0 and found.day_probability > 0.75)
    if gentle > 5.0:
        assert found.share > 0.85
        assert found.in_logs.min() > 0.9


def test_a_log_that_names_the_twin_is_not_asked_what_it_would_show_beside_it() -> None:
    """A drive shows little of an effect beside its twin, from which it can hardly be told."""
    others = {k: v for k, v in QUIET.items() if k != RIVAL}
    twin = LogEvidence(
        {RIVAL: 50.0}, others, {(RIVAL, EFFECT): 49.0}, 64, frozenset(), _sizes([RIVAL], 1.0), _sizes([EFFECT], 0.5)
    )
    (found,) = find_occurrences([shown(50.0, 50.0, True)] * 6 + [twin] * 6, DAYS, UNKNOWN_CARS)
    assert {found.effect, *found.twins} >= {EFFECT, RIVAL} or found.in_logs.min() > 0.5


def test_a_power_limit_has_the_size_that_its_law_has() -> None:
    limit = NamedEffect(effect="motor_power_limit", parameters={"P": Quantity(value=50.0, se=1.0, unit="W")})
    document = DiagnosisDocument(verdict="named", findings=(limit,))
    assert LogEvidence.of_diagnosis(document).sizes == {"motor_power_limit": {"inverse_P": pytest.approx(0.02)}}


def test_what_is_said_of_fleets_is_as_likely_as_it_is_said() -> None:
    """Fleets drawn from a known law: diagnoses that miss or mistake an effect now and then, drives that differ."""
    rng = np.random.default_rng(11)
    false = said = right_day = told_day = within = had = 0
    for fleet_ in range(160):
        has_one, day = bool(fleet_ % 2), int(rng.integers(2))
        share = rng.uniform(0.4, 0.9)
        logs = []
        for since in DAYS:
            there = has_one and since >= day and rng.random() < share
            # driven gently on the first day
            G = float(np.exp(rng.uniform(np.log(0.1), np.log(10.0 if since == 0 else 300.0))))
            z = float(rng.normal() + (np.sqrt(2.0 * G) if there else 0.0))
            price = log().price(EFFECT)
            nats = 0.5 * z**2 - price
            chance = {name: 0.5 * rng.normal() ** 2 - price for name in QUIET}
            wrong = {REST[int(rng.integers(8))]: 25.0} if rng.random() < 0.02 else {}
            named = {EFFECT: nats} if nats > 12.0 and rng.random() > 0.02 else {}
            others = {k: v for k, v in (chance | {EFFECT: nats}).items() if k not in named | wrong}
            size = {EFFECT: {SYMBOL: abs(z) / np.sqrt(2.0 * G)}}
            logs.append(LogEvidence(named | wrong, others, {}, 64, frozenset(), size, {EFFECT: {SYMBOL: G**-0.5}}))
        found = find_occurrences(logs, DAYS, UNKNOWN_CARS)
        said += len(found)
        false += sum(f.effect != EFFECT or not has_one for f in found)
        for f in found:
            if f.effect == EFFECT and has_one:
                had += 1
                told_day += f.day_probability
                right_day += f.day == day
                within += f.share_interval[0] <= share <= f.share_interval[1]
    assert false <= 0.05 * said
    assert had > 30
    assert right_day == pytest.approx(told_day, abs=2.5 * np.sqrt(had * 0.16))
    assert within > 0.8 * had


def test_where_the_cars_are_known_the_logs_of_one_stand_together() -> None:
    cars = ["a", "b", "c", "c"] * 3
    logs = [log(**{EFFECT: 9.0}) if c in "ab" and d else log() for c, d in zip(cars, DAYS, strict=True)]
    logs[4] = log(**{EFFECT: 0.0})  # of the car a
    found = find_one(logs, cars)
    assert found.day == 1
    assert found.in_logs[4] > 0.5 > found.in_logs[6]
    # without the cars each log stands for itself
    assert find_one(logs).in_logs[4] < found.in_logs[4] - 0.1


def test_a_log_that_has_an_effect_and_does_not_name_it_moves_no_parameter() -> None:
    """Four logs since the second day have it; in two, which do not name it, the motor stands in for it."""
    rng = np.random.default_rng(4)
    logs = []
    for i in range(len(DAYS)):
        blind = i in HAVING[:2]
        made = diagnosed_log(i, 2.0 * (1.3 if blind else 1.0) + 0.02 * rng.normal())
        if blind:
            others = made.document.others_nats | {"rough_patch": 9.0}
            made = made._replace(
                document=made.document.model_copy(update={"findings": (), "rivals": (), "others_nats": others})
            )
        logs.append(made)
    together = diagnose_together(logs, ALL_DAYS)
    assert together is not None
    assert [e.effect for e in together.effects] == ["rough_patch"]
    assert together.effects[0].in_logs["log_5"] > 0.5
    assert not together.moved
    assert together.left_out == ("log_5", "log_6")
    assert fleet_sentences(fleet_document(logs))[-1].startswith("Parameters are compared without log_5 and log_6")
    (K_t,) = [p for p in together.parameters if p.symbol == "K_t"]
    assert {value.log for value in K_t.logs} == {f"log_{i}" for i in range(12) if i not in HAVING[:2]}


def test_a_parameter_that_moved_is_told_with_an_interval_that_holds() -> None:
    rng = np.random.default_rng(3)
    held, false_alarms, repeats = 0, 0, 200
    for _ in range(repeats):
        se = rng.uniform(0.01, 0.03, len(DAYS))
        x = 2.0 + 0.1 * (np.array(DAYS) >= 2) + rng.normal(0.0, 0.02, len(DAYS)) + rng.normal(0.0, se)
        model = fit_days(x, se, DAYS, UNKNOWN_CARS)
        assert model is not None
        second, third = model.changes
        held += third.interval()[0] < 0.1 < third.interval()[1]
        false_alarms += second.p_value < 0.05
    assert 0.91 < held / repeats < 0.985
    assert false_alarms / repeats < 0.09


@pytest.mark.parametrize("level", [0.05, 0.01])
def test_with_uneven_errors_false_alarms_are_as_rare_as_they_say(level: float) -> None:
    rng = np.random.default_rng(6)
    alarms, repeats = 0, 1500
    for _ in range(repeats):
        se = 0.02 * np.exp(rng.normal(size=len(DAYS)))
        model = fit_days(rng.normal(0.0, 0.02, len(DAYS)) + rng.normal(0.0, se), se, DAYS, UNKNOWN_CARS)
        assert model is not None
        alarms += model.changes[0].p_value < level
    assert alarms / repeats < 1.6 * level


def test_cars_differ_without_a_day_being_another() -> None:
    rng = np.random.default_rng(8)
    cars = ["a", "b", "a", "a", "b", "b", "b", "a", "b", "b", "b", "a"]
    x = np.array([{"a": 1.0, "b": 3.0}[c] for c in cars]) + rng.normal(0.0, 0.02, len(cars))
    with_cars = fit_days(x, np.full(len(x), 0.02), DAYS, cars)
    without = fit_days(x, np.full(len(x), 0.02), DAYS, UNKNOWN_CARS)
    assert with_cars is not None
    assert without is not None
    assert all(abs(change.value) < 0.1 for change in with_cars.changes)
    assert without.tau > 10.0 * with_cars.tau


def test_a_day_on_which_another_car_drove_is_not_compared() -> None:
    cars = ["a"] * 8 + ["b"] * 4
    x = np.array([1.0] * 8 + [1.2] * 4) + 0.01 * np.arange(12) % 3
    model = fit_days(x, np.full(12, 0.01), DAYS, cars)
    assert model is not None
    assert [change.day for change in model.changes] == [1]
    assert (
        fit_days(x[4:], np.full(8, 0.01), DAYS[4:], cars[4:]) is None
        or not fit_days(x[4:], np.full(8, 0.01), DAYS[4:], cars[4:]).changes
    )  # type: ignore[union-attr]


def test_degrees_of_freedom_are_those_of_the_whole_matrices() -> None:
    """The trace of the square of P = W - W X C X' W, of which no more than a column for each car and day is formed."""
    rng = np.random.default_rng(3)
    cars = [*"aabbccaabbcc"]
    X = np.array([[c == "a", c == "b", c == "c", day == 1, day == 2] for c, day in zip(cars, DAYS, strict=True)], float)
    se, tau = rng.uniform(0.01, 0.1, len(DAYS)), 0.05
    W = np.diag(1.0 / (tau**2 + se**2))
    C = np.linalg.inv(X.T @ W @ X)
    P = W - W @ X @ C @ X.T @ W
    delta = np.array([0.0, 0.0, 0.0, 0.0, 1.0])
    V, slope = delta @ C @ delta, np.sum((delta @ C @ X.T @ W) ** 2)
    found = _Design(rng.normal(size=len(DAYS)), se, X).estimate(delta, 2, tau, np.inf)
    assert found.freedom == pytest.approx(2.0 * V**2 / (slope**2 * 2.0 / np.trace(P @ P)), rel=1e-9)


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
        (["monday/run/one.csv", "tuesday/run/one.csv"], ["monday/run", "tuesday/run"]),
        (["a/run/one.csv", "b/run/one.csv", "c/test/one.csv"], ["a/run", "b/run", "c/test"]),
        (["one.csv", "two.csv"], ["", ""]),
        (["a/2026-11-28.csv", "b/other.csv"], ["a", "b"]),
        (["2026-01-01_campaign/monday/x.csv", "2026-01-01_campaign/tuesday/x.csv"], ["monday", "tuesday"]),
        (["20261128101502.mcap", "20261129101502.mcap"], ["2026-11-28", "2026-11-29"]),
        (["friday/one.csv", "monday/one.csv"], ["friday", "monday"]),
    ],
)
def test_days_are_read_from_names_and_folders(tmp_path: Path, paths: list[str], days: list[str]) -> None:
    labels = label_logs([tmp_path / p for p in paths], [Path(p).stem for p in paths])
    assert [label.day for label in labels.of_logs] == days
    assert list(labels.days) == list(dict.fromkeys(days))


def test_a_log_without_a_date_is_named_where_others_have_one(tmp_path: Path) -> None:
    paths = [tmp_path / f"{name}.csv" for name in ("2026-11-28", "2026-11-29", "calibration")]
    told = label_logs(paths, [path.stem for path in paths]).describe()
    assert told == "days unknown, all logs count as of one; dates do not count, as calibration has none"


def test_a_table_says_day_and_car(tmp_path: Path) -> None:
    table = tmp_path / "fleet.csv"
    table.write_text("log,day,car\none.csv,2026-11-28,red\ntwo,2026-11-29,blue\n", encoding="utf-8")
    labels = label_logs([tmp_path / "one.csv", tmp_path / "two.csv"], ["one", "two"], table)
    assert labels.of_logs == (LogLabel("2026-11-28", "red"), LogLabel("2026-11-29", "blue"))
    assert labels.describe() == "days 2026-11-28 (1), 2026-11-29 (1); 2 cars"


def test_dates_of_a_table_are_the_same_day_and_in_order_however_they_are_written(tmp_path: Path) -> None:
    table = tmp_path / "fleet.csv"
    table.write_text("log,day\none,20261129\ntwo,2026-11-28\nthree,2026-11-29\n", encoding="utf-8")
    names = ["one", "two", "three"]
    labels = label_logs([tmp_path / f"{name}.csv" for name in names], names, table)
    assert labels.days == ("2026-11-28", "2026-11-29")
    assert [label.day for label in labels.of_logs] == ["2026-11-29", "2026-11-28", "2026-11-29"]


def test_days_that_are_no_dates_come_in_the_order_of_the_table(tmp_path: Path) -> None:
    table = tmp_path / "fleet.csv"
    table.write_text("Log, Day\ntwo,monday\n\none,friday\n", encoding="utf-8")
    labels = label_logs([tmp_path / "one.csv", tmp_path / "two.csv"], ["one", "two"], table)
    assert labels.days == ("monday", "friday")
    assert [label.day for label in labels.of_logs] == ["friday", "monday"]


def test_a_name_that_two_logs_share_is_refused(tmp_path: Path) -> None:
    table = tmp_path / "fleet.csv"
    table.write_text("log,day\none.csv,monday\n", encoding="utf-8")
    logs = [tmp_path / "a" / "one.csv", tmp_path / "b" / "one.csv"]
    with pytest.raises(InputRefused, match="several logs"):
        label_logs(logs, ["a/one", "b/one"], table)


@pytest.mark.parametrize(
    ("text", "cause"),
    [
        ("log,car\none,red\n", "no column day"),
        ("log,day\none,\n", "line 2"),
        ("log,day\none,a\none,b\n", "line 3"),
        ("log,day\none,a\n", "nothing of two"),
        ("", "no column log"),
        ("log,day,day\none,a,b\n", "several columns day"),
        ("log,day\none,a\n\n\ntwo,\n", "line 5"),
    ],
)
def test_a_table_that_says_too_little_is_refused(tmp_path: Path, text: str, cause: str) -> None:
    table = tmp_path / "fleet.csv"
    table.write_text(text, encoding="utf-8")
    with pytest.raises(InputRefused, match=cause):
        label_logs([tmp_path / "one.csv", tmp_path / "two.csv"], ["one", "two"], table)


def diagnosed_log(i: int, K_t: float) -> DiagnosedLog:
    """One of twelve logs, with a motor constant; those in HAVING have a rough patch somewhere."""
    has_it = i in HAVING
    patch = {"b": Quantity(value=30.0, se=1.0, unit="kg s^-1"), "x": Quantity(value=1.0 + i, se=0.01, unit="m")}
    document = DiagnosisDocument(
        verdict="named" if has_it else "nothing-found", simulation=REFITTED,
        findings=(NamedEffect(effect="rough_patch", gain_nats=30.0, parameters=patch),) if has_it else (),
        rivals=(Rival(effects=("floor_slope",), behind_nats=12.0),) if has_it else (), stretches=64,
        others_nats={k: v for k, v in (QUIET | {"rough_patch": -6.0}).items() if k != "rough_patch" or not has_it},
        base=BaseModel(parameters=(BaseParameter(symbol="K_t", value=K_t, se=0.02, unit="kg s^-1"),)),
    )  # fmt: skip
    return DiagnosedLog(f"log_{i}", LogLabel(ALL_DAYS[DAYS[i]]), document)


def fleet_document(logs: list[DiagnosedLog], days: tuple[str, ...] = ALL_DAYS) -> FleetDocument:
    """The document of a fleet."""
    rows = tuple(FleetLog(name=x.name, file=x.name, state="done", day=x.label.day, car=x.label.car) for x in logs)
    together = diagnose_together(logs, days)
    return FleetDocument(vehicle="car", models=("newton-euler",), diagnosed=True, logs=rows, together=together)


def test_diagnoses_are_put_into_words_and_on_a_page(tmp_path: Path) -> None:
    rng = np.random.default_rng(4)
    logs = [diagnosed_log(i, 2.0 * (1.1 if DAYS[i] == 2 else 1.0) + 0.02 * rng.normal()) for i in range(len(DAYS))]
    document = fleet_document(logs, (*ALL_DAYS, "2026-12-01"))
    together = document.together
    assert together is not None
    assert [e.effect for e in together.effects] == ["rough_patch"]
    (moved,) = together.moved
    assert (moved.symbol, moved.day, moved.beside) == ("K_t", "2026-11-30", "2026-11-28")
    assert moved.interval[0] < 0.1 < moved.interval[1]
    # where the patch is, is no size
    assert [p.symbol for p in together.parameters] == ["K_t", "rough_patch.b"]
    first, second, third, fourth = fleet_sentences(document)
    assert first.startswith("Rough patch is there since 2026-11-29")
    assert second == "2026-11-29: the cars of 2026-11-28, but for rough patch."
    assert third.startswith("2026-11-30: the cars of 2026-11-28, but for rough patch and K_t +")
    assert fourth == "2026-12-01: no log was diagnosed."
    page = tmp_path / "fleet.html"
    write_fleet_page(document, page)
    text = page.read_text(encoding="utf-8")
    assert text.count("<svg") == 3  # the effect's logs, and a strip each for K_t and the patch
    document.write(tmp_path / "fleet.json")
    assert FleetDocument.read(tmp_path / "fleet.json") == document


def test_the_cars_that_have_an_effect_are_named_with_their_logs() -> None:
    """Every log that shows it is of the red car."""
    logs = [diagnosed_log(i, 2.0) for i in range(len(DAYS))]
    logs = [log._replace(label=log.label._replace(car="red" if i in HAVING else "blue")) for i, log in enumerate(logs)]
    document = fleet_document(logs)
    assert document.together is not None
    (effect,) = document.together.effects
    assert effect.in_cars["red"] > 0.9
    assert effect.in_cars["blue"] < 0.1
    assert "of the cars" in fleet_sentences(document)[0]
    assert f": red ({', '.join(f'log_{i}' for i in HAVING[:-1])} and log_{HAVING[-1]})." in fleet_sentences(document)[0]


def test_an_effect_is_told_of_the_days_whose_logs_have_it() -> None:
    """It came on the second day, and no log of the third has it."""
    having = diagnosed_log(HAVING[0], 2.0).document
    lacking = diagnosed_log(0, 2.0).document
    logs = [
        diagnosed_log(i, 2.0)._replace(document=having if DAYS[i] == 1 else lacking) for i in range(len(DAYS))
    ]  # fmt: skip
    _, second, third = fleet_sentences(fleet_document(logs))
    assert second == "2026-11-29: the cars of 2026-11-28, but for rough patch."
    assert third == "2026-11-30: no parameter is shown to be another than on 2026-11-28."


def test_what_is_drawn_to_a_published_figure_is_compared_as_each_log_alone_shows_it() -> None:
    """A change of 10 % is told as such, though a simulation trusted to 5 % draws every log to its figure."""
    rng, trust, se = np.random.default_rng(7), 0.05, 0.05
    changes, held = [], []
    for _ in range(40):
        logs = []
        for i in range(len(DAYS)):
            alone = np.log(2.0 * (1.1 if DAYS[i] == 2 else 1.0)) + se * rng.normal()
            drawn = (alone / se**2 + np.log(2.0) / trust**2) / (se**-2 + trust**-2)
            K_t = BaseParameter(
                symbol="K_t", value=np.exp(drawn), se=np.exp(drawn) * (se**-2 + trust**-2) ** -0.5,
                of_recording=Quantity(value=np.exp(alone), se=np.exp(alone) * se),
            )  # fmt: skip
            document = diagnosed_log(0, 2.0).document.model_copy(
                update={"simulation": "published", "base": BaseModel(parameters=(K_t,))}
            )
            logs.append(DiagnosedLog(f"log_{i}", LogLabel(ALL_DAYS[DAYS[i]]), document))
        together = diagnose_together(logs, ALL_DAYS)
        assert together is not None
        (parameter,) = together.parameters
        first, last = parameter.days[0], parameter.days[-1]
        changes.append(last.mean / first.mean - 1.0)
        held.append(last.ci95[0] < 2.2 < last.ci95[1])
    assert np.mean(changes) == pytest.approx(0.1, abs=0.02)
    assert np.mean(held) > 0.85


def test_a_log_that_cannot_say_is_not_listed_and_leaves_a_gap_on_the_page(tmp_path: Path) -> None:
    logs = [diagnosed_log(i, 2.0) for i in range(len(DAYS))]
    silent = logs[0].document.model_copy(update={"others_nats": QUIET})
    document = fleet_document([logs[0]._replace(document=silent), *logs[1:]])
    assert document.together is not None
    assert sorted(document.together.effects[0].in_logs) == sorted(f"log_{i}" for i in range(1, len(DAYS)))
    write_fleet_page(document, tmp_path / "fleet.html")


def test_an_effect_that_a_log_has_without_naming_it_has_no_size_over_days() -> None:
    logs = [diagnosed_log(i, 2.0) for i in range(len(DAYS))]
    weak = logs[HAVING[0]].document.model_copy(
        update={"findings": (), "rivals": (), "others_nats": QUIET | {"rough_patch": 25.0}}
    )
    logs[HAVING[0]] = logs[HAVING[0]]._replace(document=weak)
    together = diagnose_together(logs, ALL_DAYS)
    assert together is not None
    assert together.effects[0].in_logs[f"log_{HAVING[0]}"] > 0.5
    assert [p.symbol for p in together.parameters] == ["K_t"]


def test_a_change_in_either_sign_is_told_with_its_interval() -> None:
    moved = MovedParameter(
        symbol="steering_offset.o", day="b", beside="a", change=-0.02, se=0.004, interval=(-0.03, -0.01),
        relative=False, unit="rad", p_value=1e-4,
    )  # fmt: skip
    assert change_in_words(moved) == "o of steering offset −0.020 rad (−0.030 to −0.010 rad)"


def test_numbers_that_are_none_do_not_count() -> None:
    document = diagnosed_log(5, 2.0).document.model_copy(update={"others_nats": QUIET | {EFFECT: float("nan")}})
    assert EFFECT not in LogEvidence.of_diagnosis(document).effects


def test_one_diagnosed_log_says_nothing_of_a_fleet() -> None:
    assert diagnose_together([diagnosed_log(0, 2.0)], ALL_DAYS) is None
