"""The balance of forces that docs/real_recordings.md tells of the DART."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from dart_balance import PUBLISHED, RESULT, balance, drags

from bcid.diagnosis.reference import read_parameter_file
from bcid.effects.constants import Constants
from bcid.models import published
from bcid.models.interface import history_at_rest, rollout
from bcid.models.newton_euler.augmented import AugmentedNewtonEuler
from bcid.vehicle import Body

BODY = Body(mass_kg=1.58, cog_to_front_m=0.0805, cog_to_rear_m=0.093, drive="all", front_drive_share=0.5)
PERIOD_S = 0.02


@pytest.mark.parametrize("angle", [0.2, -0.38])
@pytest.mark.parametrize("k", [0.0, 2.2, 9.0])
def test_the_drag_of_a_car_that_turns_steadily_is_found(angle: float, k: float) -> None:
    p = read_parameter_file(PUBLISHED)
    effects = {f"{name}__{s}": v for name, values in p.effects.items() for s, v in values.items()}
    geometry = {"m": 1.58, "l_f": 0.0805, "l_r": 0.093, "front_share": 0.5, "sets_force": 1.0, "u_0": 0.0}
    car = (
        published.newton_euler().car._replace(T_s=0.04, F_m_max=1e4, **geometry)._replace(**p.parameters | {"K_v": 0.0})
    )
    model = AugmentedNewtonEuler(car, effects | {"steering_drag__k": k}, Constants(), 0.42, 60.0, PERIOD_S, {})
    throttle = 0.25  # slow, as the drives are
    twist = rollout(model, history_at_rest(1), np.tile([angle, throttle], (1000, 1)))
    assert twist[-1] == pytest.approx(twist[-2], abs=1e-6)
    delta, needed, own = drags(twist[-1], 0.0, throttle, BODY, p)
    assert delta == pytest.approx(angle, rel=0.05)  # but for the tyres' slip
    assert needed == pytest.approx(own * k / p.effects["steering_drag"]["k"], abs=0.03)


def test_the_committed_balance_is_that_of_the_recordings(recordings_folder: Path) -> None:
    found, told = balance(recordings_folder), json.loads(RESULT.read_text(encoding="utf-8"))
    assert [row.pop("drive") for row in found] == [row.pop("drive") for row in told]
    for now, then in zip(found, told, strict=True):
        assert now == pytest.approx(then, abs=0.002)
