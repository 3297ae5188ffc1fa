"""What drags the real DART car at steady speed, beside what is published of it: docs/results/dart_balance.json.

`python tests/dart_balance.py FOLDER` writes that file from the recordings.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np

from bcid.diagnosis.simulation import read_parameters
from bcid.proof.asked import Asked
from bcid.proof.real_cases import read_cases
from bcid.vehicle import read_vehicle

ROOT = Path(__file__).parents[1]
DART = ROOT / "pipelines" / "dart"
RESULT = ROOT / "docs" / "results" / "dart_balance.json"
DRIVES = ("09_25_2024_09_50_18", "09_25_2024_09_57_26")
WINDOW_S = 6.0
STARTED_S = 10.0  # after the first command; as much before the last


def balance(folder: Path) -> list[dict[str, float | str]]:
    """Of each window of the two drives the means of what was driven, and the drag (N) that the balance of forces needs.

    m (v_x' - omega v_y) = F_m - F_rolling - F_yf sin(delta) - F_drag, the wheel's angle delta and the front tyres'
    force F_yf from speed and yaw rate; beside it the published F_drag = k |delta| v_fx.
    """
    cases = read_cases(DART / "cases.toml")
    asked = Asked(read_vehicle(DART / "vehicle.toml"), cases.calibrated, None, folder)
    return [row for drive in DRIVES for row in _of_drive(drive, asked)]


def _of_drive(drive: str, asked: Asked) -> list[dict[str, float | str]]:
    name = next(n for n in asked.calibrated if drive in n)
    vehicle, offset = asked.vehicle_of(name), asked.calibrated[name]["columns"]["throttle_mps"]["offset"]
    recording, estimate, _ = asked.moved(name, vehicle)
    p = read_parameters(DART / "simulation.toml")
    body, e, (R_1, R_2, K_t) = vehicle.body, p.effects, (p.parameters[s] for s in ("R_1", "R_2", "K_t"))
    L, driven = body.cog_to_front_m + body.cog_to_rear_m, recording.commands.values[:, 1]
    t, of = estimate.time_s, recording.commands.time_s
    u = np.interp(t, of, driven)
    on = of[driven > 0.0][[0, -1]] + [STARTED_S, -STARTED_S]
    rows = []
    for begin in np.arange(on[0], on[1] - WINDOW_S, WINDOW_S):
        here = (t >= begin) & (t < begin + WINDOW_S) & np.isfinite(estimate.twist).all(axis=1)
        v_x, v_y, omega = estimate.twist[here].mean(axis=0)
        slope = np.polyfit(t[here], estimate.twist[here, 0], 1)[0]
        delta, throttle = np.arctan2(L * omega, v_x), u[here].mean()
        v_fx = v_x * np.cos(delta) + (v_y + body.cog_to_front_m * omega) * np.sin(delta)
        F_m = (K_t - e["motor_fade"]["k"] * v_x) * (throttle - e["motor_dead_zone"]["width"])
        F_rolling = e["rear_rolling_coulomb"]["c"] + R_1 * v_x + R_2 * v_x**2
        F_side = body.mass_kg * v_x * omega * body.cog_to_rear_m / L * np.tan(delta)
        needed = F_m - F_rolling - F_side - body.mass_kg * (slope - omega * v_y)
        rows.append({
            "drive": drive, "begin_s": begin, "angle_rad": delta, "throttle": throttle - offset, "v_x_mps": v_x,
            "drag_N": needed, "published_N": e["steering_drag"]["k"] * abs(delta) * v_fx,
        })  # fmt: skip
    return [{k: v if isinstance(v, str) else round(float(v), 4) for k, v in row.items()} for row in rows]


if __name__ == "__main__":
    RESULT.write_text(json.dumps(balance(Path(sys.argv[1])), indent=1) + "\n", encoding="utf-8")
