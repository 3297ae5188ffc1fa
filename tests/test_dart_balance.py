"""The balance of forces that docs/dart.md tells of the DART."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from dart_balance import DRIVES, RESULT, balance, drags
from dart_formulas import PUBLISHED, STEERING, published_car

from bcid.diagnosis.reference import read_parameter_file
from bcid.effects.constants import Constants
from bcid.models.interface import history_at_rest, rollout
from bcid.models.newton_euler.augmented import AugmentedNewtonEuler
from bcid.vehicle import Body

BODY = Body(mass_kg=1.58, cog_to_front_m=0.0805, cog_to_rear_m=0.093, drive="all", front_drive_share=0.5)
PERIOD_S = 0.02
PAGE = Path(__file__).parents[1] / "docs" / "dart.md"


@pytest.mark.parametrize(
    ("angle", "share", "throttle"),
    [(0.2, 0.0, 0.23), (-0.38, 0.0, 0.23), (0.2, 1.0, 0.27), (-0.38, 1.0, 0.3), (0.2, 1.5, 0.29), (-0.38, 1.5, 0.33)],
)
def test_the_drag_of_a_car_that_turns_steadily_is_found(angle: float, share: float, throttle: float) -> None:
    """Of a published car whose steered wheel drags so many times as much, driven slowly, as the drives are."""
    p = read_parameter_file(PUBLISHED)
    car, effects = published_car(p, BODY)
    effects |= {field: share * v for field, v in effects.items() if field.partition("__")[0] in STEERING}
    model = AugmentedNewtonEuler(car._replace(T_s=0.04), effects, Constants(), 0.42, 60.0, PERIOD_S, {})
    twist = rollout(model, history_at_rest(1), np.tile([angle, throttle], (1000, 1)))
    assert twist[-1] == pytest.approx(twist[-2], abs=1e-6)
    assert 0.2 < twist[-1, 0] < 0.7
    delta, needed, own = drags(twist[-1], 0.0, throttle, BODY, p)
    assert delta == pytest.approx(angle, rel=0.06)  # but for the tyres' slip
    assert needed == pytest.approx(share * own * angle / delta, abs=0.03)


def test_the_page_tells_what_the_balance_shows() -> None:
    """Least and largest drag of each drive, as needed and as published, and what is left of it, in N."""
    rows, page = json.loads(RESULT.read_text(encoding="utf-8")), " ".join(PAGE.read_text(encoding="utf-8").split())
    for drive in DRIVES:
        needed, published = ([r[k] for r in rows if r["drive"] == drive] for k in ("drag_N", "published_N"))
        left = [n - p for n, p in zip(needed, published, strict=True)]
        told = [f"{min(x):.1f} to {max(x):.1f} N" for x in (needed, published, left)]
        assert f"needs {told[0]}, published are {told[1]}, and {told[2]} are left" in page, (drive, told)
    slow, quick = ([r for r in rows if r["drive"] == DRIVES[1]][i] for i in (-2, -1))
    for name in ("v_x_mps", "drag_N", "published_N", "formula_N"):
        assert f"{slow[name]:.2f} to {quick[name]:.2f} {'m/s' if name == 'v_x_mps' else 'N'}" in page


def test_what_is_left_grows_with_time_and_not_with_the_angle() -> None:
    """Which falls in one drive and grows in the other; in the first a zero of the throttle of 0.168 leaves nothing."""
    rows = json.loads(RESULT.read_text(encoding="utf-8"))
    for drive, way in zip(DRIVES, (-1.0, 1.0), strict=True):
        here = [r for r in rows if r["drive"] == drive]
        left = np.array([r["drag_N"] - r["published_N"] for r in here])
        time, angle = [r["begin_s"] for r in here], [abs(r["angle_rad"]) for r in here]
        assert np.corrcoef(left, time)[0, 1] > 0.9
        assert way * np.corrcoef(left, angle)[0, 1] > 0.9
        if drive == DRIVES[0]:
            p = read_parameter_file(PUBLISHED)
            v = np.array([r["v_x_mps"] for r in here])
            per_throttle = p.parameters["K_t"] - p.effects["motor_fade"]["k"] * v
            assert p.effects["motor_dead_zone"]["width"] + np.mean(left / per_throttle) == pytest.approx(
                0.168, abs=5e-4
            )


@pytest.mark.slow
def test_the_committed_balance_is_that_of_the_recordings(recordings_folder: Path) -> None:
    found, told = balance(recordings_folder), json.loads(RESULT.read_text(encoding="utf-8"))
    assert [row.pop("drive") for row in found] == [row.pop("drive") for row in told]
    for now, then in zip(found, told, strict=True):
        assert now == pytest.approx(then, abs=0.002)
