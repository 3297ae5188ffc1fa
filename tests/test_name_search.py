"""The search for names from end to end, on simulated takes."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from concealed import concealing
from weighed_names import GATE, NOTHING, Evidence, beside, chance, fit, trials, weights_of

from bcid.diagnosis.limits import SEARCH_LIMITS
from bcid.diagnosis.remainder.evidence import likeliest_spreads
from bcid.diagnosis.search import name_search, refits
from bcid.diagnosis.search.name_search import Naming, name_effects, refit_beside_reference
from bcid.diagnosis.search.name_weights import NameWeights
from bcid.diagnosis.search.refits import named_effects
from bcid.diagnosis.search.screen import CandidateEffect
from bcid.effects.remainder import DIRECTION, DIRECTIONS
from bcid.effects.table import EFFECTS
from bcid.errors import PredictionDiverged
from bcid.likelihood.score_test import TrialChanges

# --- from end to end -------------------------------------------------------------------------------------------------


def test_what_is_left_counts_beyond_chance_only() -> None:
    for nats, unknown in ((GATE - 1.0, 0.0), (GATE + 1.0, GATE + 1.0)):
        named = fit(0.0)
        found = Naming(named, named, beside(named), beside(named, nats), {}, {}, (), {}, chance())
        assert found.unknown_nats == unknown
    louder = chance()._replace(placebos=[CandidateEffect("rear_toe", [0.0], GATE + 5.0)])
    assert found._replace(nulls=louder).unknown_nats == 0.0


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
    looking, found = weights_of(), beside(fit(evidence, "rear_toe"))
    drawn = list[tuple[str, ...]]()
    monkeypatch.setattr(NameWeights, "draw_nulls", lambda self, rest: drawn.append(rest.named.hypothesis.effects))
    monkeypatch.setattr(name_search, "add_names_plainly", lambda *_: fit(plain, "yaw_scrub"))
    monkeypatch.setattr(name_search, "add_names_beside_remainder", lambda *_: found)
    best = name_search._add_names(looking, beside(fit(0.0), 80.0), [], lambda text: None)
    assert best.named.hypothesis.effects == (("yaw_scrub",) if taken == "plain" else ("rear_toe",))
    assert drawn == [("yaw_scrub",)] * (1 if explains_all or taken == "beside" else 2)


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
    assert min(found.gains.values()) > found.nulls.gate
    assert found.unknown_nats == 0.0
    assert {n: named_effects(f) for n, f in found.without.items()} == {
        "yaw_scrub": ("rear_rolling_coulomb",), "rear_rolling_coulomb": ("yaw_scrub",),
    }  # fmt: skip
    assert found.before.log_evidence > found.corrected.penalised_log_likelihood + 500.0


def test_a_constant_law_is_named_though_a_copy_of_it_would_explain_as_much() -> None:
    base, take = concealing(steering_offset=0.0125)
    found = name_effects(base, take)
    assert named_effects(found.best) == ("steering_offset",)
    assert found.gains["steering_offset"] > found.nulls.gate
    value, se = found.best.effect_estimates()["steering_offset__o"]
    assert abs(value - 0.0125) < 4.0 * se


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
    names = ["yaw_scrub", "rear_toe", "motor_sag", "floor_slope", "quadratic_drag"]
    given = list[tuple[str, ...]]()
    monkeypatch.setattr(name_search, "simulate_trials", lambda reference, take: trials(*names, "yaw_coulomb"))

    def screened(reference: Any, take: Any, some: TrialChanges) -> list[CandidateEffect]:
        given.append(tuple(t.effect for t in some.trials))
        return [CandidateEffect(name, [1.0], 50.0) for name in names]

    def quick(f: Any, take: Any, c: CandidateEffect) -> Any:
        if c.effect == "rear_toe":
            raise PredictionDiverged
        return fit(10.0, c.effect)

    monkeypatch.setattr(name_search, "screen_effects", screened)
    monkeypatch.setattr(refits, "refit_along_tangent", quick)
    monkeypatch.setattr(refits, "refit_fully", lambda f, take: f)
    found = refit_beside_reference(fit(0.0), NOTHING, ("yaw_coulomb",))
    assert given == [tuple(names)]
    tried = names[: SEARCH_LIMITS.max_candidates]
    assert [f.hypothesis.effects for f in found] == [(name,) for name in tried if name != "rear_toe"]

    def lost(*_: Any) -> Any:
        raise PredictionDiverged

    monkeypatch.setattr(name_search, "simulate_trials", lost)
    assert refit_beside_reference(fit(0.0), NOTHING, ()) == []
