"""The search for names from end to end, on simulated takes."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from concealed import concealing
from weighed_names import GATE, Evidence, beside, chance, fit, simulating, state_of

from bcid.diagnosis.limits import SEARCH_LIMITS
from bcid.diagnosis.remainder.chance import Chance
from bcid.diagnosis.remainder.evidence import likeliest_spreads
from bcid.diagnosis.search import name_search, refits
from bcid.diagnosis.search.keep_names import KeptNames
from bcid.diagnosis.search.name_search import Naming, name_effects, refit_beside
from bcid.diagnosis.search.refits import named_effects
from bcid.diagnosis.search.rivals import Alternatives
from bcid.diagnosis.search.screen import CandidateEffect
from bcid.diagnosis.search.search_state import SearchState
from bcid.effects.remainder_table import DIRECTION, DIRECTIONS
from bcid.effects.table import EFFECTS
from bcid.errors import PredictionDiverged

# --- from end to end -------------------------------------------------------------------------------------------------


def test_what_is_left_counts_beyond_chance_only() -> None:
    for nats, unknown in ((GATE - 1.0, 0.0), (GATE + 1.0, GATE + 1.0)):
        named = fit(0.0)
        found = Naming(named, named, beside(named), beside(named, nats), {}, {}, (), {}, {}, chance())
        assert found.unknown_nats == unknown
    louder = chance()._replace(placebos=[CandidateEffect("rear_toe", [0.0], GATE + 5.0)])
    assert found._replace(nulls=louder).unknown_nats == 0.0
    assert found._replace(chance=Chance(0.5 * GATE, 0.3 * GATE)).unknown_nats == 0.0
    assert found._replace(chance=Chance(0.1, 0.1)).unknown_nats == GATE + 1.0


@pytest.mark.parametrize(
    ("plain", "evidence", "explains_all", "taken"),
    [(90.0, 200.0, True, "plain"), (90.0, 200.0, False, "beside"), (250.0, 200.0, False, "plain")],
)
def test_names_are_sought_beside_a_remainder_where_something_is_left_without(
    plain: float, evidence: float, explains_all: bool, taken: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The likelier of the two ends stands."""
    left = 0.0 if explains_all else GATE + 1.0
    Evidence(monkeypatch, {("yaw_scrub",): left})
    looking, found = state_of(), beside(fit(evidence, "rear_toe"))
    drawn = list[tuple[str, ...]]()
    monkeypatch.setattr(SearchState, "draw_nulls", lambda self, rest: drawn.append(rest.named.hypothesis.effects))
    monkeypatch.setattr(name_search, "add_names_plainly", lambda *_: fit(plain, "yaw_scrub"))
    monkeypatch.setattr(name_search, "add_names_beside_remainder", lambda *_: found)
    best = name_search._add_names(looking, beside(fit(0.0), 80.0), [], lambda text: None)
    assert best.named.hypothesis.effects == (("yaw_scrub",) if taken == "plain" else ("rear_toe",))
    end = best.named.hypothesis.effects
    assert drawn == [("yaw_scrub",)] if explains_all else [("yaw_scrub",), end]


def kept_of(named: Any, remainder: float = 0.0, **gains: float) -> KeptNames:
    rest = beside(named, remainder)
    return KeptNames(rest, rest, gains, {name: fit(0.0, f"less_{name}") for name in gains})


@pytest.mark.parametrize(("left", "again"), [(20.0 + GATE + 1.0, True), (20.0 + GATE - 1.0, False)])
def test_names_are_sought_again_for_what_one_that_went_had_explained(
    left: float, again: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    Evidence(monkeypatch, {})
    asked, sought = list[tuple[str, ...]](), list[tuple[str, ...]]()

    def keep(state: SearchState, rest: Any) -> KeptNames:
        asked.append(rest.named.hypothesis.effects)
        return kept_of(fit(50.0), left) if len(asked) == 1 else kept_of(rest.named, rear_toe=90.0)

    def seek(state: SearchState, rest: Any, more: Any, report: Any) -> Any:
        sought.append(rest.named.hypothesis.effects)
        return beside(fit(150.0, "rear_toe"))

    monkeypatch.setattr(name_search, "keep_names", keep)
    monkeypatch.setattr(name_search, "add_names_beside_remainder", seek)
    kept = name_search._keep_and_seek_again(state_of(), beside(fit(100.0, "yaw_scrub"), 20.0), lambda text: None)
    assert asked == ([("yaw_scrub",), ("rear_toe",)] if again else [("yaw_scrub",)])
    assert sought == ([()] if again else [])
    assert set(kept.gains) == ({"rear_toe"} if again else set())


@pytest.mark.parametrize(("evidence", "taken"), [(130.0, True), (90.0, False)])
def test_a_likelier_exchange_is_a_name_or_a_rival(
    evidence: float, taken: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where a remainder makes up for it the old name stays, and the other is told as its rival."""
    mine, other, third = fit(100.0, "yaw_scrub"), fit(120.0, "rear_toe"), fit(60.0, "motor_sag")
    Evidence(monkeypatch, {("rear_toe",): evidence - 120.0})
    simulating(monkeypatch)

    def exchange(f: Any, take: Any, some: Any, known: Any) -> Alternatives:
        return Alternatives(other, (mine, third))

    monkeypatch.setattr(name_search, "exchange_until_stable", exchange)
    monkeypatch.setattr(name_search, "keep_names", lambda state, rest: kept_of(rest.named, rear_toe=evidence))
    kept, rivals = name_search._exchange_names(state_of(), kept_of(mine, yaw_scrub=100.0), ())
    assert kept.rest.named.hypothesis.effects == (("rear_toe",) if taken else ("yaw_scrub",))
    assert [f.hypothesis.effects[0] for f in rivals] == (
        ["yaw_scrub", "motor_sag"] if taken else ["rear_toe", "motor_sag"]
    )


def test_the_names_stay_where_what_comes_in_for_one_does_not(monkeypatch: pytest.MonkeyPatch) -> None:
    """It must add more than chance makes of it, which may be more than the old name must."""
    mine, other = fit(100.0, "yaw_scrub"), fit(120.0, "mass_change")
    Evidence(monkeypatch, {})
    simulating(monkeypatch)
    monkeypatch.setattr(name_search, "exchange_until_stable", lambda *_: Alternatives(other, (mine,)))
    monkeypatch.setattr(name_search, "keep_names", lambda state, rest: kept_of(fit(0.0)))
    kept, rivals = name_search._exchange_names(state_of(), kept_of(mine, yaw_scrub=100.0), ())
    assert kept.gains == {"yaw_scrub": 100.0}
    assert [f.hypothesis.effects for f in rivals] == [("mass_change",)]


def test_rivals_are_those_of_the_names_that_stay(monkeypatch: pytest.MonkeyPatch) -> None:
    """Also where an exchange is taken, and a name falls after it."""
    Evidence(monkeypatch, {})
    asked = list[tuple[str, ...]]()

    def exchange(f: Any, take: Any, some: Any, known: Any) -> Alternatives:
        asked.append(f.hypothesis.effects)
        if len(f.hypothesis.effects) == 2:
            return Alternatives(fit(120.0, "rear_toe", "motor_sag"), (f,))
        return Alternatives(f, (fit(110.0, "yaw_coulomb"),))

    monkeypatch.setattr(name_search, "exchange_until_stable", exchange)
    monkeypatch.setattr(name_search, "keep_names", lambda state, rest: kept_of(fit(115.0, "rear_toe"), rear_toe=90.0))
    before = kept_of(fit(100.0, "yaw_scrub", "motor_sag"), yaw_scrub=50.0, motor_sag=50.0)
    kept, rivals = name_search._exchange_names(state_of(), before, ())
    assert kept.rest.named.hypothesis.effects == ("rear_toe",)
    assert asked == [("yaw_scrub", "motor_sag"), ("rear_toe",)]
    assert [f.hypothesis.effects for f in rivals] == [("yaw_coulomb",)]


@pytest.mark.parametrize("falls", [True, False])
def test_what_was_refused_beside_a_name_that_went_is_tried_again(falls: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    looking = state_of(refused={"motor_sag", "yaw_scrub"})
    left = 100.0 if falls else 0.0
    kept = kept_of(fit(0.0) if falls else fit(0.0, "yaw_scrub"), left)
    asked = list[set[str]]()
    monkeypatch.setattr(name_search, "keep_names", lambda state, rest: kept)
    monkeypatch.setattr(
        name_search, "add_names_beside_remainder", lambda state, rest, *_: asked.append(set(state.refused)) or rest
    )
    name_search._keep_and_seek_again(looking, beside(fit(0.0, "yaw_scrub")), lambda text: None)
    assert asked == ([{"yaw_scrub"}] if falls else [])


def test_an_excluded_effect_is_never_named_nor_tried() -> None:
    base, take = concealing(yaw_scrub=20.0)
    texts = list[str]()
    found = name_effects(base, take, ("yaw_scrub", "yaw_coulomb"), report=texts.append)
    assert not {"yaw_scrub", "yaw_coulomb"} & {*found.gains, *found.dropped}
    assert not [r for r in found.rivals if {"yaw_scrub", "yaw_coulomb"} & set(r.hypothesis.effects)]
    assert not [text for text in texts if "yaw_scrub" in text or "yaw_coulomb" in text]
    assert found.before.nats > 500.0  # which is there


def test_two_effects_are_named_each_by_what_it_adds() -> None:
    base, take = concealing(yaw_scrub=20.0, rear_rolling_coulomb=20.0)
    found = name_effects(base, take)
    assert set(found.gains) == {"yaw_scrub", "rear_rolling_coulomb"} == set(named_effects(found.best))
    assert all(gain > found.gate_of(name) for name, gain in found.gains.items())
    assert found.unknown_nats == 0.0
    assert {n: named_effects(f) for n, f in found.without.items()} == {
        "yaw_scrub": ("rear_rolling_coulomb",), "rear_rolling_coulomb": ("yaw_scrub",),
    }  # fmt: skip
    assert found.before.log_evidence > found.corrected.penalised_log_likelihood + 500.0


def test_a_constant_law_is_named_though_a_copy_of_it_would_explain_as_much() -> None:
    base, take = concealing(steering_offset=0.0125)
    found = name_effects(base, take)
    assert named_effects(found.best) == ("steering_offset",)
    assert found.gains["steering_offset"] > found.gate_of("steering_offset")
    value, se = found.best.effect_estimates()["steering_offset__o"]
    assert abs(value - 0.0125) < 4.0 * se


@pytest.mark.slow
def test_a_friction_that_comes_and_goes_has_no_name() -> None:
    """Functions that turn round where the car does explain it best; no constant friction is named for it."""
    base, take = concealing(180.0, bearing_heat=60.0)
    found = name_effects(base, take)
    assert "rear_rolling_coulomb" not in found.gains
    assert found.unknown_nats > 50.0
    seen = found.before.seen
    assert next(iter(seen.channel_nats())) == "fx"
    size = seen.basis.size.copy()
    size[np.flatnonzero(seen.basis.functions[:, DIRECTION] == DIRECTIONS.index("rolling"))] = 0.0
    less = seen.basis._replace(size=size)
    spread = likeliest_spreads(seen.quadratic, less, less.groups(()), seen.spread)
    whole = seen.quadratic.log_evidence(seen.basis.sd(seen.spread))
    assert whole > seen.quadratic.log_evidence(less.sd(spread)) + 30.0


def test_a_late_pose_is_named_instead_of_two_late_commands() -> None:
    from bcid.simulation.car import Sensor

    base, take = concealing(sensor=Sensor(pose_latency=0.015))
    found = name_effects(base, take)
    assert named_effects(found.best) == ("pose_latency",)
    value, se = found.best.effect_estimates()["pose_latency__tau"]
    assert abs(value - 0.015) < 4.0 * se
    assert EFFECTS["pose_latency"].kind == "measurement"


def test_beside_a_reference_the_first_effect_is_sought_from_its_own_parameters(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Joint refits hold the corrections of the base model, too, so that they can be compared with it."""
    base, take = concealing(120.0, yaw_scrub=20.0)
    corrected = refits.refit_with_effects(base, take, ("slip_speed",), [0.1])
    found = refit_beside(base, corrected, take, ())
    assert 0 < len(found) <= SEARCH_LIMITS.max_candidates
    assert {f.hypothesis.effects[:-1] for f in found} == {("slip_speed",)}
    best = max(found, key=lambda f: f.penalised_log_likelihood)
    assert named_effects(best) == ("yaw_scrub",)
    assert best.penalised_log_likelihood > corrected.penalised_log_likelihood + 100.0
    without = refit_beside(base, corrected, take, ("yaw_scrub",))
    assert "yaw_scrub" not in {f.hypothesis.effects[-1] for f in without}

    def lost(*_: Any) -> Any:
        raise PredictionDiverged

    monkeypatch.setattr(name_search, "simulate_trials", lost)
    assert refit_beside(base, corrected, take, ()) == []
