"""What a refitted base model takes up hardly shows in a score test, and is sought by refits from large sizes."""

from __future__ import annotations

import pytest
from concealed import record_case

from bcid.diagnosis.diagnose import fit_base_model
from bcid.diagnosis.search.refits import gain_nats, refit_from_large_sizes
from bcid.diagnosis.search.screen import screen_effects, simulate_trials
from bcid.proof.blind.other_suite import draft_other_cases


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
