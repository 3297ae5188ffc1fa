"""From fits to findings: probabilities, twins, gates; and how values are told."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from bcid.diagnosis.judge import verdict
from bcid.diagnosis.judge.held_out import HeldOutGain
from bcid.diagnosis.judge.verdict import Finding, _finding_probability, _indistinguishable_effects, _passes_gates
from bcid.diagnosis.search.screen import CandidateEffect, NullGains
from bcid.effects.table import EFFECTS, ENTRIES
from bcid.likelihood.score_test import null_quantile

SEGMENTS = 80
TAKE: Any = SimpleNamespace(T=120.0)


def fit(penalised_log_likelihood: float, *effects: str, per_segment: float = 0.0) -> Any:
    hypothesis = SimpleNamespace(effects=effects, entries=ENTRIES, assumed=())
    return SimpleNamespace(
        hypothesis=hypothesis,
        penalised_log_likelihood=penalised_log_likelihood,
        per_segment=np.full(SEGMENTS, per_segment),
    )


def search(best: Any, without: dict[str, Any], *others: Any, placebo: float = 2.0) -> Any:
    chance = NullGains(0.001, 14.0, 12.0, [CandidateEffect("rear_toe", [0.01], placebo)])
    return SimpleNamespace(best=best, leave_one_out=without, rivals=others, nulls=chance, corrected=fit(0.0))


def test_a_second_effect_is_as_probable_as_its_own_gain_makes_it() -> None:
    """A strong first effect lends nothing to a weak second one."""
    best = fit(1000.0, "yaw_scrub", "rear_toe")
    found = search(best, {"yaw_scrub": fit(20.0, "rear_toe"), "rear_toe": fit(999.0, "yaw_scrub")})
    assert _finding_probability(found, "yaw_scrub") > 0.99
    assert _finding_probability(found, "rear_toe") < 0.63


def test_a_rival_that_explains_as_much_halves_the_probability_and_is_a_twin() -> None:
    best, other = fit(1000.0, "yaw_scrub"), fit(999.9, "quadratic_drag")
    found = search(best, {"yaw_scrub": fit(0.0)}, other)
    assert _indistinguishable_effects(best, found, TAKE, "yaw_scrub") == ("quadratic_drag",)
    assert _finding_probability(found, "yaw_scrub") == pytest.approx(0.5, abs=0.03)
    behind = fit(900.0, "quadratic_drag", per_segment=-100.0 / SEGMENTS)
    assert _indistinguishable_effects(best, search(best, {}, behind), TAKE, "yaw_scrub") == ()


@pytest.mark.parametrize(
    ("effect", "value", "gain", "heldout", "passes"),
    [
        ("yaw_scrub", 13.0, 100.0, (90.0, (40.0, 140.0)), True),
        ("yaw_scrub", 13.0, 100.0, (30.0, (-10.0, 70.0)), False),  # not sure on blocks not seen
        ("yaw_scrub", 13.0, 13.0, (90.0, (40.0, 140.0)), False),  # no more than chance
        ("yaw_scrub", 0.1, 100.0, (90.0, (40.0, 140.0)), False),  # matters to no prediction
        ("rough_patch", 30.0, 100.0, (30.0, (-10.0, 70.0)), True),  # local: no block but one gains
        ("rough_patch", 30.0, 100.0, (11.0, (5.0, 20.0)), False),
    ],
)
def test_gates(
    effect: str, value: float, gain: float, heldout: tuple[float, tuple[float, float]], passes: bool
) -> None:
    parameters = EFFECTS[effect].parameters
    values = {p.symbol: (value if i == 0 else 1.0, 0.1) for i, p in enumerate(parameters)}
    finding = Finding(effect, (), 0.9, values, gain, HeldOutGain(*heldout))
    assert _passes_gates(finding, search(fit(1000.0, effect), {})) is passes
    above_all = search(fit(1000.0, effect), {}, placebo=150.0)
    assert not _passes_gates(finding, above_all)


def test_what_is_told_in_the_end_is_where_no_range_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    """A refit without something else may lead what was credible to an end: the weakest such is dropped."""
    sizes = {"mass_change": 100.0, "marker_offset": 50.0, "yaw_scrub": 10.0}
    ends = {("mass_change", "marker_offset", "yaw_scrub"): ("mass_change", "marker_offset")}
    ends[("mass_change", "yaw_scrub")] = ("mass_change",)

    gone = list[tuple[tuple[str, ...], tuple[str, ...]]]()

    def found(best: Any) -> Any:
        seen = search(best, {n: fit(best.penalised_log_likelihood - sizes[n]) for n in best.hypothesis.effects})
        seen.base = fit(0.0)
        seen.corrected = seen.base
        seen.reduce_to = lambda rest, take, standing_in, at_ends: gone.append((standing_in, at_ends)) or found(rest)
        return seen

    def seen(found: Any, take: Any) -> list[Finding]:
        return [Finding(n, (), 0.9, {}, sizes[n], HeldOutGain(9.0, (1.0, 9.0))) for n in found.best.hypothesis.effects]

    monkeypatch.setattr(verdict, "_collect_findings", seen)
    monkeypatch.setattr(verdict, "_passes_gates", lambda *_: True)
    monkeypatch.setattr(verdict, "find_proxies", lambda *_: ())
    monkeypatch.setattr(
        verdict.refits, "refit_with_effects", lambda best, take, effects: fit(sum(map(sizes.get, effects)), *effects)
    )
    monkeypatch.setattr(verdict.refits, "effects_at_bounds", lambda fit, take: ends.get(fit.hypothesis.effects, ()))
    monkeypatch.setattr(verdict, "RemainingMismatch", SimpleNamespace(beside=lambda *_: None))
    told = verdict.judge_search(found(fit(160.0, *sizes)), TAKE)
    assert told.dropped == ("marker_offset", "mass_change")
    assert gone == [((), ("marker_offset",)), ((), ("mass_change",))]  # which tells nothing of what stands in
    assert [f.effect for f in told.findings] == ["yaw_scrub"]


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
