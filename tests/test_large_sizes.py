"""What a refitted base model takes up hardly shows in a score test, and is sought by refits from large sizes."""

from __future__ import annotations

from contextlib import nullcontext
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from concealed import concealing, record_case

from bcid.aliases import Floats
from bcid.diagnosis.diagnose import fit_base_model
from bcid.diagnosis.search import name_search, refits
from bcid.diagnosis.search.name_search import name_effects
from bcid.diagnosis.search.refits import (
    WHOLE_REFITS,
    _sizes_beside_simulation,
    estimates_by_symbol,
    gain_nats,
    refit_from_large_sizes,
    refit_from_simulation,
)
from bcid.diagnosis.search.screen import screen_effects, simulate_trials
from bcid.effects.table import EFFECTS
from bcid.errors import PredictionDiverged
from bcid.likelihood.hypothesis import Hypothesis
from bcid.likelihood.linearised_segments import (
    linearise_with_pushes,
    linearise_without_pushes,
    log_likelihood_along,
)
from bcid.likelihood.refit import Fit, evaluate_fixed
from bcid.likelihood.take import Take
from bcid.proof.blind.other_suite import draft_other_cases
from bcid.simulation.car import Sensor


@pytest.mark.slow
def test_a_dead_zone_that_a_weaker_motor_imitates_is_found_from_a_large_size() -> None:
    drawn = (draw_case(90421, 1361) for draw_case in draft_other_cases(0, 40))
    case = next(case for case in drawn if case.answer == ("motor_dead_zone",))
    drive = record_case(case)
    base = fit_base_model([drive.recording], [drive.estimate], drive.vehicle, drive.reference)
    promised = {c.effect: c.score for c in screen_effects(base.fit, base.take, simulate_trials(base.fit, base.take))}
    (found,) = refit_from_large_sizes(base.fit, base.take, ())
    assert found.hypothesis.effects[-1] == "motor_dead_zone"
    assert gain_nats(found, base.fit) > max(500.0, 4.0 * promised["motor_dead_zone"])
    assert base.fit.car().K_t < found.car().K_t


def test_a_large_effect_is_found_beside_a_simulation_as_it_is_given() -> None:
    """Of the effects that are refitted, the delay that was made is the likeliest; an excluded effect is not tried."""
    known, (base, take) = concealing(60.0)[0], concealing(60.0, steering_delay=0.12)
    given = evaluate_fixed(take, base.hypothesis, base.hypothesis.phi_of(known.car()), base.scales)
    found = refit_from_simulation(given, base, take, ())
    assert len(found) == WHOLE_REFITS
    best = found[0]
    assert gain_nats(best, found[1]) >= 0.0
    (tau,) = estimates_by_symbol(best, "steering_delay").values()
    assert tau[0] == pytest.approx(0.12, abs=0.01)
    assert gain_nats(best, base) > 20.0
    others = refit_from_simulation(given, base, take, ("steering_delay",))
    assert all("steering_delay" not in fit.hypothesis.effects for fit in others)


def given_as_trusted(seconds: float) -> tuple[Fit, Take]:
    """A simulation trusted to a fiftieth, as it is given, beside a take of a car whose steering is late."""
    base, take = concealing(seconds, steering_delay=0.12)
    trusting = base.hypothesis.trust_simulation([], 0.02)
    return evaluate_fixed(take, trusting, base.phi, base.scales), take


@pytest.mark.parametrize(("segments", "stride"), [(41, 4), (19, 1), (23, 2)])
def test_a_part_of_a_take_says_as_much_less_against_a_simulation(
    segments: int, stride: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A short take is compared on more of its segments; on the whole take a simulation counts as it is known."""
    whole, whole_take = given_as_trusted(72.0)
    given, take = whole.part(whole_take, np.arange(segments))
    asked = list[tuple[int, float]]()  # segments of each refit, and the share by which its simulation counts

    def record(take: Take, hypothesis: Hypothesis, phi: Floats, *_: Any, **__: Any) -> Fit:
        assert hypothesis.trusted_simulation
        asked.append((take.segments, hypothesis.trusted_simulation.share))
        return replace(given, hypothesis=hypothesis, phi=phi)

    monkeypatch.setattr(refits, "refit", record)
    starts = [given.hypothesis.add_effect(name, given.phi, [0.05]) for name in ("steering_delay", "motor_delay")]
    found = refits._refit_likeliest(given, take, starts, 1)
    part = len(range(0, segments, stride))
    assert asked == [(part, part / segments)] * 2 + [(segments, 1.0)]
    assert [f.hypothesis for f in found] == [starts[0][0]]


@pytest.mark.parametrize("on_part", [True, False])
def test_what_ends_at_a_bound_of_its_size_is_left_out(on_part: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whether on the part on which effects are compared or on the whole take."""
    given, take = given_as_trusted(60.0)

    def run_to_bound(on: Take, hypothesis: Hypothesis, phi: Floats, *_: Any, **__: Any) -> Fit:
        found, field = phi.copy(), "steering_offset__o"
        if field in hypothesis.effect_values(phi) and (on.segments < take.segments) == on_part:
            found[-1] = hypothesis.bounds()[1][-1]
        return replace(given, hypothesis=hypothesis, phi=found)

    monkeypatch.setattr(refits, "refit", run_to_bound)
    starts = [given.hypothesis.add_effect(name, given.phi, [0.01]) for name in ("steering_offset", "steering_delay")]
    found = refits._refit_likeliest(given, take, starts, 2)
    assert [f.hypothesis.effects for f in found] == [("steering_delay",)]


def test_an_effect_shows_where_no_pushes_make_up_for_it() -> None:
    """With those of a simulation that lacks it, it would be there twice: the true size seems unlikely."""
    sensor = Sensor()._replace(position_noise=1e-4, yaw_noise=2e-4)
    known, (base, take) = concealing(60.0, sensor=sensor)[0], concealing(60.0, sensor=sensor, steering_offset=0.03)
    given = evaluate_fixed(take, base.hypothesis, base.hypothesis.phi_of(known.car()), base.scales)
    truth, phi = given.hypothesis.add_effect("steering_offset", given.phi, [0.03])
    settled = evaluate_fixed(take, truth, phi, given.scales).log_likelihood
    with_pushes, without = (
        settled - log_likelihood_along(at, take, truth, phi)
        for at in (linearise_with_pushes(given), linearise_without_pushes(given, take))
    )
    assert 0.0 < without < 0.3 * with_pushes
    assert with_pushes > 1000.0


@pytest.mark.parametrize(("missing", "asked"), [(0.12, True), (0.0, False)])
def test_large_sizes_are_tried_beside_a_simulation_where_something_is_missing(
    missing: float, asked: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    base, take = concealing(60.0, **({"steering_delay": missing} if missing else {}))
    tried = list[tuple[Fit, tuple[str, ...]]]()

    def record_and_stop(given: Fit, corrected: Fit, take: Take, excluded: tuple[str, ...]) -> list[Fit]:
        tried.append((given, excluded))
        raise PredictionDiverged

    monkeypatch.setattr(refits, "refit_from_simulation", record_and_stop)
    monkeypatch.setattr(name_search, "_add_names", lambda state, before, more, report: before)
    name_effects(base, take, ("yaw_scrub",))
    assert not tried
    with pytest.raises(PredictionDiverged) if asked else nullcontext():
        name_effects(base, take, ("yaw_scrub",), (), base)
    assert tried == ([(base, ("yaw_scrub",))] if asked else [])


@pytest.mark.parametrize("name", [name for name, effect in EFFECTS.items() if not effect.place_parameters])
def test_every_effect_without_a_place_is_tried_beside_a_simulation(name: str) -> None:
    """Within its bounds, either way where it has two, each of its parameters alone."""
    effect = EFFECTS[name]
    sizes = list(_sizes_beside_simulation(effect))
    assert len(sizes) == 2 * sum(1 + (p.low < p.off) for p in effect.parameters)
    for values in sizes:
        (moved,) = [i for i, p in enumerate(effect.parameters) if values[i] != p.off]
        p, size = effect.parameters[moved], abs(values[moved])
        assert p.low <= values[moved] <= p.high
        assert size in (pytest.approx(p.size), pytest.approx(4.0 * p.size)) or values[moved] in (p.low, p.high)


def test_an_effect_with_a_place_is_not_tried_large() -> None:
    assert not list(_sizes_beside_simulation(EFFECTS["rough_patch"]))
