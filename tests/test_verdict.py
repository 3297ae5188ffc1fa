"""From fits to findings: verdicts, probabilities and twins of names; and how values are told."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from concealed import concealing

from bcid.diagnosis.judge import verdict
from bcid.diagnosis.judge.held_out import HeldOutGain
from bcid.diagnosis.judge.verdict import are_indistinguishable, judge_names
from bcid.diagnosis.limits import JUDGE_LIMITS
from bcid.diagnosis.search.name_search import Naming, name_effects
from bcid.diagnosis.search.screen import CandidateEffect, NullGains
from bcid.effects.table import EFFECTS, ENTRIES
from bcid.likelihood.score_test import null_quantile

SEGMENTS = 80
TAKE: Any = SimpleNamespace(T=120.0)
GAINED = HeldOutGain(90.0, (40.0, 140.0))


def fit(penalised_log_likelihood: float, *effects: str, per_segment: Any = 0.0) -> Any:
    hypothesis = SimpleNamespace(effects=effects, entries=ENTRIES, assumed=())
    return SimpleNamespace(
        hypothesis=hypothesis, penalised_log_likelihood=penalised_log_likelihood, log_prior=0.0,
        per_segment=np.broadcast_to(per_segment, SEGMENTS),
    )  # fmt: skip


def naming(best: Any, gains: dict[str, float], *rivals: Any, unknown: float = 0.0, corrected: bool = False) -> Any:
    """What a search has found, of the nats that each name gains, beside a remainder of so many."""
    base = fit(0.0)
    without = {name: fit(best.penalised_log_likelihood - nats) for name, nats in gains.items()}
    rest = SimpleNamespace(named=best, fit=fit(0.0, "with a remainder") if unknown else best, nats=unknown)
    nulls = NullGains(14.0, [CandidateEffect("rear_toe", [0.01], 2.0)])
    return Naming(base, fit(5.0, "tyre_fall") if corrected else base, rest, rest, gains, without, rivals, {}, {}, nulls)


@pytest.fixture
def judged(monkeypatch: pytest.MonkeyPatch) -> Any:
    """The judgement of a naming, without a take."""
    monkeypatch.setattr(verdict, "held_out_log_likelihoods", lambda fit, take: fit)
    monkeypatch.setattr(verdict, "bootstrap_gain", lambda better, worse, take, prior=0.0: GAINED)
    monkeypatch.setattr(verdict.refits, "estimates_by_symbol", lambda fit, name: {"of": (len(name), 0.1)})
    return lambda found: judge_names(found, TAKE)


# --- verdicts ------------------------------------------------------------------------------------------------------


def test_names_that_nothing_equals_are_named_by_what_each_gains(judged: Any) -> None:
    said = judged(naming(fit(300.0, "yaw_scrub", "motor_sag"), {"yaw_scrub": 90.0, "motor_sag": 150.0}))
    assert said.verdict == "named"
    assert [(f.effect, f.gain_nats) for f in said.findings] == [("motor_sag", 150.0), ("yaw_scrub", 90.0)]
    assert all(f.held_out == GAINED for f in said.findings)
    assert said.findings[0].values == {"of": (len("motor_sag"), 0.1)}
    assert said.unknown is said.corrections is None


def test_a_name_with_a_rival_as_good_is_ambiguous(judged: Any) -> None:
    best = fit(300.0, "yaw_scrub", "motor_sag")
    twin = fit(299.0, "motor_sag", "yaw_coulomb")
    said = judged(naming(best, {"yaw_scrub": 90.0, "motor_sag": 150.0}, twin))
    assert said.verdict == "ambiguous"
    assert {f.effect: f.twins for f in said.findings} == {"motor_sag": (), "yaw_scrub": ("yaw_coulomb",)}


@pytest.mark.parametrize(
    ("unknown", "corrected", "expected"),
    [(0.0, False, "nothing-found"), (60.0, False, "unknown"), (0.0, True, "unknown"), (60.0, True, "unknown"),
     (13.0, False, "nothing-found")],
)  # fmt: skip
def test_what_has_no_name_is_unknown_only_beyond_chance(
    unknown: float, corrected: bool, expected: str, judged: Any
) -> None:
    """A remainder that adds more than the gate, or a base model whose own simplifications had to be put right."""
    found = naming(fit(0.0), {}, unknown=unknown, corrected=corrected)
    said = judged(found)
    assert said.verdict == expected
    assert said.findings == ()
    assert (said.unknown is not None) is (unknown > found.nulls.gate)
    assert (said.corrections is not None) is corrected


def test_beside_names_what_is_left_is_told_and_changes_no_verdict(judged: Any) -> None:
    said = judged(naming(fit(300.0, "yaw_scrub"), {"yaw_scrub": 90.0}, unknown=500.0))
    assert said.verdict == "named"
    assert said.unknown == GAINED


# --- probabilities -------------------------------------------------------------------------------------------------


def test_a_second_effect_is_as_probable_as_its_own_gain_makes_it(judged: Any) -> None:
    """A strong first effect lends nothing to a weak second one."""
    strong, weak = judged(naming(fit(1000.0, "yaw_scrub", "rear_toe"), {"yaw_scrub": 980.0, "rear_toe": 1.0})).findings
    assert strong.probability > 0.99
    assert weak.probability == pytest.approx(1.0 / (1.0 + np.exp(-1.0 / JUDGE_LIMITS.probability_temper)))


def test_a_rival_that_explains_as_much_halves_the_probability(judged: Any) -> None:
    best, other = fit(1000.0, "yaw_scrub"), fit(999.9, "quadratic_drag")
    (finding,) = judged(naming(best, {"yaw_scrub": 1000.0}, other)).findings
    assert finding.twins == ("quadratic_drag",)
    assert finding.probability == pytest.approx(0.5, abs=0.03)
    better = fit(1004.0, "quadratic_drag")  # which search would have taken: no name is likelier than even
    assert judged(naming(best, {"yaw_scrub": 1000.0}, better)).findings[0].probability == pytest.approx(0.5)


def test_every_rival_counts_and_only_those_of_the_name(judged: Any) -> None:
    """exp(-nats / T) each, as much as nothing in its place; a rival of the other name says nothing of this one."""
    T, best = JUDGE_LIMITS.probability_temper, fit(1000.0, "yaw_scrub", "rear_toe")
    rivals = fit(994.0, "quadratic_drag", "rear_toe"), fit(996.0, "motor_sag", "rear_toe"), fit(999.0, "yaw_scrub", "x")
    probabilities = {f.effect: f.probability for f in judged(
        naming(best, {"yaw_scrub": 8.0, "rear_toe": 50.0}, *rivals)).findings}  # fmt: skip
    expected = 1.0 / (1.0 + np.exp(-6.0 / T) + np.exp(-4.0 / T) + np.exp(-8.0 / T))
    assert probabilities["yaw_scrub"] == pytest.approx(expected)
    assert probabilities["rear_toe"] > 0.99


# --- twins ---------------------------------------------------------------------------------------------------------


def scattered(mean: float, sd: float) -> Any:
    """Differences of segments (S,) with just this mean, which scatter so from one to the next."""
    each = np.random.default_rng(1).standard_normal(SEGMENTS)
    return mean + sd * (each - each.mean()) / each.std()


@pytest.mark.parametrize(
    ("behind", "mean", "sd", "alike"),
    [
        (3.9, 3.9 / SEGMENTS, 0.0, True),  # 55 : 1 is not enough, however it came about
        (4.1, 4.1 / SEGMENTS, 0.0, False),
        (15.0, 15.0 / SEGMENTS, 2.0, True),  # far less than it scatters
        (15.0, 15.0 / SEGMENTS, 0.1, False),
        (20.5, 15.0 / SEGMENTS, 9.0, False),  # scatter excuses no more
    ],
)
def test_two_fits_are_alike_as_vuong_says(behind: float, mean: float, sd: float, alike: bool) -> None:
    best = fit(1000.0, "yaw_scrub", per_segment=scattered(mean, sd))
    assert are_indistinguishable(best, fit(1000.0 - behind, "rear_toe"), TAKE) is alike


def test_a_take_of_one_block_says_nothing_of_scatter() -> None:
    short: Any = SimpleNamespace(T=1e4)  # blocks of 20 s
    best, rival = fit(1000.0, "yaw_scrub"), fit(990.0, "rear_toe")
    best.per_segment, rival.per_segment = scattered(0.1, 9.0)[:13], np.zeros(13)
    assert not are_indistinguishable(best, rival, short)


def test_twins_are_told_once_most_likely_first_and_not_too_many(judged: Any) -> None:
    best = fit(1000.0, "yaw_scrub")
    names = ["quadratic_drag", "motor_sag", "rear_toe", "yaw_coulomb", "floor_slope"]
    rivals = [fit(999.0 - 0.1 * k, name) for k, name in enumerate(names)]
    (finding,) = judged(naming(best, {"yaw_scrub": 900.0}, rivals[0], *rivals)).findings
    assert finding.twins == tuple(names[: JUDGE_LIMITS.max_twins])


def test_what_differs_in_another_way_is_no_twin(judged: Any) -> None:
    """Without any name, with two others, or with one of the base model's own corrections in its place."""
    rivals = (
        fit(999.9),
        fit(999.9, "rear_toe", "motor_sag"),
        fit(999.9, "tyre_fall"),
        fit(999.9, "yaw_scrub", "motor_sag"),
    )
    (finding,) = judged(naming(fit(1000.0, "yaw_scrub"), {"yaw_scrub": 900.0}, *rivals)).findings
    assert finding.twins == ()
    assert finding.probability > 0.99


def test_a_late_pose_always_has_the_pair_of_delays_as_its_twin(judged: Any) -> None:
    """Both commands late are the same drive, seen by another clock."""
    said = judged(naming(fit(1000.0, "pose_latency"), {"pose_latency": 900.0}))
    assert said.verdict == "ambiguous"
    assert said.findings[0].twins == ("steering_delay+motor_delay",)


# --- of a take -----------------------------------------------------------------------------------------------------


def test_a_name_of_a_take_is_judged_with_all_that_belongs_to_it() -> None:
    base, take = concealing(yaw_scrub=20.0)
    found = name_effects(base, take)
    said = judge_names(found, take)
    assert said.verdict == "named"
    (finding,) = said.findings
    value, se = finding.values["c"]
    assert abs(value - 20.0) < 4.0 * se
    assert finding.gain_nats == found.gains["yaw_scrub"]
    assert finding.probability > 0.99
    assert finding.held_out.ci95[0] > 0.0
    assert found.unknown_nats == 0.0


def test_what_may_not_be_named_is_unknown_and_helps_on_blocks_not_seen() -> None:
    base, take = concealing(yaw_scrub=20.0)
    turning = [name for name, e in EFFECTS.items() if e.channel in ("mz", "any", "pose")]
    found = name_effects(base, take, turning)
    said = judge_names(found, take)
    assert (said.verdict, said.findings) == ("unknown", ())
    assert found.unknown_nats > found.nulls.gate
    assert said.unknown is not None
    assert said.unknown.ci95[0] > 0.0
    assert next(iter(found.rest.seen.channel_nats())) == "mz"


# --- how values are told -------------------------------------------------------------------------------------------


def test_a_level_is_met_as_rarely_as_it_says() -> None:
    """For the greatest of 60 halves of a chi-square with one degree of freedom."""
    rng = np.random.default_rng(0)
    known = 0.5 * (rng.standard_normal((999, 60)) ** 2).max(axis=1)
    many = 0.5 * (rng.standard_normal((200_000, 60)) ** 2).max(axis=1)
    rate = float(np.mean(many > null_quantile(known, 1e-3)))
    assert 2e-4 < rate < 2e-3


def test_units_are_told_as_the_specification_has_them() -> None:
    told = {
        "rear_rolling_viscous": "N s/m", "steering_drag": "N s/(m rad)", "yaw_scrub": "N m s", "floor_slope": "m/s²",
        "steering_friction": "N/rad",
        "quadratic_drag": "N s²/m²", "steering_nonlinearity": "rad⁻²", "steering_compliance": "rad/N",
        "friction_circle": "–", "load_transfer": "s²/m", "steering_speed_gain": "s/m", "motor_dead_zone": "m/s",
    }  # fmt: skip
    for name, unit in told.items():
        assert EFFECTS[name].parameters[0].quote(1.0, 0.1).unit == unit


def test_a_power_limit_is_told_as_a_power() -> None:
    """1/P = 0.005 +- 0.0005 is P = 200 +- 20 W."""
    quoted = EFFECTS["motor_power_limit"].parameters[0].quote(0.005, 0.0005)
    assert (quoted.symbol, quoted.unit) == ("P", "W")
    assert quoted.value == pytest.approx(200.0)
    assert quoted.se == pytest.approx(20.0)


def test_every_entry_names_its_source() -> None:
    assert all(e.source for e in ENTRIES.values())
