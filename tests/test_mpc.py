"""The MPC example: the docs tell its committed figures, its observer knows the past, and it reaches a goal."""

from __future__ import annotations

import importlib.util
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scene
from exported_models import CAR, augmented_car, written
from figures import drives_table, predictions_table, summarise

from bcid.documents.diagnosis import DiagnosisDocument
from bcid.export.exported import export_model
from bcid.models.newton_euler.model import NewtonEuler
from bcid.physics.car import typical_inertia_and_tyres

ROOT = Path(__file__).parent.parent
RESULTS = ROOT / "docs" / "results" / "mpc.json"
SIZE_DIGITS = {
    "steering_delay": 4, "steering_nonlinearity": 5, "tyre_soft_saturation": 3, "rear_rolling_coulomb": 1,
    "rear_rolling_viscous": 1,
}  # fmt: skip
"""Digits after the point with which docs/mpc.md tells the size of each effect that was found."""
HEAVY_CAR = CAR._replace(
    m=320.0,
    K_t=275.0,
    K_b=600.0,
    R_1=43.0,
    R_2=4.0,
    v_0=1.0,
    **typical_inertia_and_tyres(320.0, 0.6, 0.5, 1.0, 5.0, 4.0),
)
"""Stiff enough to be a car, and slow enough for steps of 0.1 s."""
needs_casadi = pytest.mark.skipif(importlib.util.find_spec("casadi") is None, reason="casadi is not installed")


@pytest.fixture(scope="module")
def committed() -> dict[str, Any]:
    found: dict[str, Any] = json.loads(RESULTS.read_text(encoding="utf-8"))
    return found


def test_the_page_s_tables_are_the_committed_figures(committed: dict[str, Any]) -> None:
    page = (ROOT / "docs" / "mpc.md").read_text(encoding="utf-8")
    assert drives_table(committed) in page
    assert predictions_table(committed) in page
    told, summary = " ".join(page.split()), committed["summary"]
    own, plain = summary["augmented"], summary["unaugmented"]
    blind, blind_plain = (100.0 * s["blind_m"]["median"] for s in (own, plain))
    assert f"ends {blind:.0f} cm from where the augmented model says, and {blind_plain:.0f} cm without" in told
    assert f"all {own['parked']} drives end parked, and nothing is touched" in told
    assert own["touched"] == 0
    assert plain["parked"] == plain["drives"]
    assert plain["touched"] == 0
    closest = [100.0 * s["least_clearance_m"] for s in (own, plain)]
    assert "came as near as {:.1f} cm, the unaugmented one as {:.1f} cm".format(*closest) in told
    times, ends = ([s[key]["median"] for s in (own, plain)] for key in ("time_s", "position_error_m"))
    assert f"in {times[0]:.1f} s and {100.0 * ends[0]:.1f} cm from the mark" in told
    assert f"take {times[1]:.1f} s and end {100.0 * ends[1]:.1f} cm from it" in told
    assert own["time_s"]["high"] < plain["time_s"]["low"]
    assert own["position_error_m"]["high"] < plain["position_error_m"]["low"]
    assert summary["linear"]["parked"] == 0
    beyond, backward = own["beyond_90_deg_s"]["median"], 100.0 * own["backward_m"]["median"]
    assert f"beyond 90° for {beyond:.1f} s, and the car rolls {backward:.0f} cm backward" in told


def test_the_page_s_sizes_are_those_of_the_committed_diagnosis() -> None:
    found = DiagnosisDocument.read(ROOT / "docs" / "results" / "mpc_diagnosis.json")
    told = " ".join((ROOT / "docs" / "mpc.md").read_text(encoding="utf-8").split())
    for finding in found.findings:
        ((size, digits),) = ((p, SIZE_DIGITS[finding.effect]) for p in finding.parameters.values())
        assert f"{size.value:.{digits}f} ± {size.se:.{digits}f}".replace("-", "−") in told
    assert {finding.effect for finding in found.findings} == set(SIZE_DIGITS)
    (after,) = (1.0 - h.ratio for h in found.horizons if h.horizon_s == 2.0)
    assert f"after 2 s falls by {100.0 * after:.0f} %" in told


def test_the_committed_summary_is_that_of_the_committed_drives(committed: dict[str, Any]) -> None:
    again = json.loads(json.dumps(summarise(committed["drives"], committed["concealed"])))
    assert again["summary"] == committed["summary"]
    assert again["predictions_m"] == committed["predictions_m"]


def test_the_fitted_model_reaches_its_goal_with_its_wheel_beyond_a_right_angle(committed: dict[str, Any]) -> None:
    own = [d for d in committed["drives"] if d["model"] == "augmented"]
    assert len(own) >= 10
    assert all(d["parked"] and d["clearance_m"] > 0.0 for d in own)
    assert min(d["largest_servo_deg"] for d in own) > 90.0
    assert min(d["backward_m"] for d in own) > 0.05


def test_what_counts_as_parked_follows_from_the_tracks(committed: dict[str, Any]) -> None:
    for d in committed["drives"]:
        distance, turn = scene.goal_errors(np.array(d["track"][-1][:3]))
        within = distance <= scene.TOLERANCE.position and turn <= scene.TOLERANCE.heading
        assert within or not d["parked"]
        assert len(d["track"]) == round(d["time_s"] / 0.1) + 1


@needs_casadi
def test_an_observer_that_is_told_all_commands_remembers_those_under_way(tmp_path: Path) -> None:
    from exported import load_predictor
    from observer import Observer

    model = augmented_car({"steering_delay__tau": 0.05})
    written(export_model(model, "0" * 64, None, "late"), ["casadi"], tmp_path)
    late = load_predictor(tmp_path, "late")
    observer = Observer(late, np.zeros(3))
    sent = [0.1, 0.2, 0.3, 0.4]
    for steering in sent:
        observer.predict([steering, 0.0])
        observer.update(np.zeros(3))
    past = {name: value for name, value in zip(late.states, observer.z, strict=True) if name.startswith("u_s_ago_")}
    # beside the pose, twist and wheel, the state holds the commands that have not yet acted, newest first
    assert [past[f"u_s_ago_{k}"] for k in range(1, len(past) + 1)] == pytest.approx(sent[::-1][: len(past)])
    assert len(past) >= 2


@needs_casadi
def test_a_short_drive_straight_ahead_reaches_its_goal(tmp_path: Path) -> None:
    from drives import drive
    from exported import load_predictor
    from problem import ParkingProblem, ProblemSettings

    written(export_model(NewtonEuler(HEAVY_CAR, 0.1, {}), "0" * 64, None, "plain"), ["casadi"], tmp_path)
    model = load_predictor(tmp_path, "plain")

    class ModelCar:
        """The model in place of a car, seen without noise."""

        def __init__(self, pose: tuple[float, float, float]) -> None:
            self.z = model.init(pose, (0.0, 0.0, 0.0), 0.0)

        pose = property(lambda self: self.z[:3].copy())
        speed = property(lambda self: math.hypot(*self.z[model.motion][:2]))
        servo_angle = property(lambda self: float(self.z[model.states.index("delta")]))

        def measure_pose(self) -> np.ndarray:
            return self.pose

        def advance(self, u: np.ndarray, seconds: float) -> None:
            self.z = np.asarray(model.step(self.z, u)).ravel()

    x, y, heading = scene.GOAL
    start = (x - math.cos(heading), y - math.sin(heading), heading)
    problem = ParkingProblem(model, ProblemSettings(blocks=15, first_iterations=20, guesses=1))
    there = drive(problem, ModelCar(start), time_limit_s=8.0)
    assert there.parked
    assert scene.goal_errors(there.pose[0])[0] > 0.9
    assert scene.goal_errors(there.pose[-1])[0] <= scene.TOLERANCE.position
    # commands keep their limits
    assert np.abs(np.diff(there.command[:, 0])).max() <= problem.period_s * problem.settings.max_steering_rate + 1e-6
