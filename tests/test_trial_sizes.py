"""Effects are tried at sizes that matter: small ones show where whole ones bend a precise recording's predictions."""

from __future__ import annotations

import pytest
from concealed import record_case

from bcid.diagnosis.diagnose import fit_base_model
from bcid.diagnosis.search.screen import screen_effects, simulate_trials
from bcid.likelihood.limits import LIKELIHOOD_LIMITS
from bcid.proof.blind.small_suite import draft_small_cases


def test_a_motor_that_loses_little_shows_in_a_precise_recording() -> None:
    """Tried at 27 % alone it seemed to add 10 nats, and a load that came on 159.

    Pushes that last take up a part of what it loses, so that less is promised, and of less, than is there.
    """
    drawn = (draw_case(2408849165, 1052) for draw_case in draft_small_cases(3, 60))
    case = next(case for case in drawn if case.tier == "small-plus" and case.answer == ("motor_sag",))
    drive = record_case(case)
    base = fit_base_model([drive.recording], [drive.estimate], drive.vehicle, drive.reference)
    first = screen_effects(base.fit, base.take, simulate_trials(base.fit, base.take))[0]
    assert first.effect == "motor_sag"
    assert first.values == pytest.approx([dict(case.concealed[0].parameters)["s"]], rel=0.4)
    assert first.score > 3.0 * LIKELIHOOD_LIMITS.usual_gate_nats
