"""What drags the real DART car at steady speed, beside what is published of it: docs/results/dart_balance.json.

`python tests/dart_balance.py FOLDER` writes that file from the recordings.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import numpy.typing as npt

from bcid.diagnosis.reference import ParameterFile, read_parameter_file
from bcid.effects.constants import Constants
from bcid.proof.real.question_files import QuestionInputs
from bcid.proof.real.questions import RecordedDrive
from bcid.vehicle import Body, read_vehicle

ROOT = Path(__file__).parents[1]
DART = ROOT / "pipelines" / "dart"
PUBLISHED = DART / "simulation.toml"
RESULT = ROOT / "docs" / "results" / "dart_balance.json"
FOLDER = "dart/82_huge_datest_for_gp_fitting/car_1_Datarecording_"
# By drive what is added to the throttle. By the published forces at steady speed straight ahead the car of that day is
# driven from a throttle of 0.197 (in 09_57_26) or 0.204 (in 09_50_18), published: 0.164; each of the two has the zero
# that the other one shows. That the friction is as published is assumed.
DRIVES = {"09_25_2024_09_50_18": -0.033, "09_25_2024_09_57_26": -0.040}
WINDOW_S = 6.0
STARTED_S = 10.0  # after the first command; as much before the last


def drags(
    twist: npt.NDArray[np.float64], gain_mps2: float, throttle: float, body: Body, p: ParameterFile
) -> tuple[float, float, float]:
    """The wheel's angle (rad), the drag (N) along it that the balance of forces needs there, and the published one.

    Of a steady turn with v_x, v_y, omega in which v_x gains so many m/s^2.  The angle is that of a wheel without slip:

        m (v_x' - omega v_y) = F_lf / cos(delta) - F_side tan(delta) + F_lr,    F_side = m omega v_x l_r / L,
        F_lf = s (F_m - R)(v_fx) - F_drag,    F_lr = (1 - s) (F_m - R)(v_x) - F_rolling,    F_drag = k |delta| v_fx.
    """
    m, s, l_f, l_r = body.mass_kg or 0.0, body.front_drive_share or 0.0, body.cog_to_front_m, body.cog_to_rear_m
    v_x, v_y, omega = twist
    delta = np.arctan2((l_f + l_r) * omega, v_x)
    v_fx = v_x * np.cos(delta) + (v_y + l_f * omega) * np.sin(delta)

    def pulling(v: float) -> float:
        held = throttle - p.effects["motor_dead_zone"]["width"]
        return (p.parameters["K_t"] - p.effects["motor_fade"]["k"] * v) * held - (
            p.parameters["R_1"] * v + p.parameters["R_2"] * v**2
        )

    F_lr = (1.0 - s) * pulling(v_x) - p.effects["rear_rolling_coulomb"]["c"] * np.tanh(v_x / Constants().v_c)
    F_side = m * omega * v_x * l_r / (l_f + l_r)
    F_lf = np.cos(delta) * (m * (gain_mps2 - omega * v_y) - F_lr + F_side * np.tan(delta))
    return delta, s * pulling(v_fx) - F_lf, p.effects["steering_drag"]["k"] * abs(delta) * v_fx


def balance(folder: Path) -> list[dict[str, float | str]]:
    """Of each window of the two drives the means of what was driven, with `drags`."""
    drives = [
        RecordedDrive(
            recording=f"{FOLDER}{drive}.csv", vehicle={"columns": {"throttle_mps": {"offset": zero, "low": 0.0}}}
        )
        for drive, zero in DRIVES.items()
    ]
    asked = QuestionInputs(read_vehicle(DART / "vehicle.toml"), {d.recording: d for d in drives}, None, folder)
    return [row for drive in DRIVES for row in _of_drive(drive, asked)]


def _of_drive(drive: str, asked: QuestionInputs) -> list[dict[str, float | str]]:
    name, offset = f"{FOLDER}{drive}.csv", DRIVES[drive]
    vehicle = asked.vehicle_for(name)
    recording, estimate, _ = asked.estimate_recording(name, vehicle)
    t, of, driven = estimate.time_s, recording.commands.time_s, recording.commands.values[:, 1]
    on = of[driven > 0.0][[0, -1]] + [STARTED_S, -STARTED_S]
    p, rows = read_parameter_file(PUBLISHED), list[dict[str, float | str]]()
    for begin in np.arange(on[0], on[1] - WINDOW_S, WINDOW_S):
        here = (t >= begin) & (t < begin + WINDOW_S) & np.isfinite(estimate.twist).all(axis=1)
        twist, throttle = estimate.twist[here].mean(axis=0), float(np.interp(t[here], of, driven).mean())
        gain = float(np.polyfit(t[here], estimate.twist[here, 0], 1)[0])
        delta, needed, published = drags(twist, gain, throttle, vehicle.body, p)
        told = {
            "begin_s": begin, "angle_rad": delta, "throttle": throttle - offset, "v_x_mps": twist[0],
            "drag_N": needed, "published_N": published,
        }  # fmt: skip
        rows.append({"drive": drive} | {k: round(float(v), 4) for k, v in told.items()})
    return rows


if __name__ == "__main__":
    RESULT.write_text(json.dumps(balance(Path(sys.argv[1])), indent=1) + "\n", encoding="utf-8")
