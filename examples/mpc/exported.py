"""An exported model as its user finds it: NAME_casadi.py is imported, NAME.json read.  Nothing of bcid is needed."""

import importlib.util
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

POSE = ("p_x", "p_y", "theta")
MOTION = ("v_x", "v_y", "yaw_rate")


@dataclass(frozen=True)
class Predictor:
    """A model that also knows where the car is: z = (pose, what the model remembers), one period of the exported step.

    A car with effects keeps its pose in its own state x, so that z is x.  Any other model is given one: z = (pose, x),
    and the exported `move` carries the pose on.
    """

    name: str
    period_s: float
    states: tuple[str, ...]  # names of the numbers in z
    step: ca.Function  # (z, u) -> z one period later
    init: Any  # (pose, twist, delta) -> z (DM) of a car whose past is not known
    steering_range: tuple[float, float]  # rad, of the commands that the model was fitted on

    @property
    def motion(self) -> slice:
        """Where v_x, v_y (m/s) and the yaw rate (rad/s) stand in z."""
        first = self.states.index(MOTION[0])
        return slice(first, first + 3)


def load_predictor(folder: Path, name: str) -> Predictor:
    """The model that `bcid export … --format casadi --name NAME --out FOLDER` has written.

    Raises:
        ValueError: its poses are of another point than its states' (see "Of which point" in docs/export.md).
    """
    spec = importlib.util.spec_from_file_location(f"{name}_casadi", folder / f"{name}_casadi.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    about = json.loads((folder / f"{name}.json").read_text(encoding="utf-8"))
    own_pose = module.STATES[:3] == POSE
    if own_pose and any(key.startswith("marker_offset") for key in about["constants"]):
        raise ValueError(f"{name}: poses are of a marker, states of the centre of gravity: export it --as vehicle")
    states = tuple(module.STATES) if own_pose else (*POSE, *module.STATES)
    z, u = ca.SX.sym("z", len(states)), ca.SX.sym("u", 2)
    if own_pose:
        z_next, _ = module.step(z, u)
    else:
        x = z[3:]
        first = module.STATES.index(MOTION[0])
        x_next, twist = module.step(x, u)
        z_next = ca.vertcat(module.move(z[:3], x[first : first + 3], twist), x_next)

    def init(pose: Any, twist: Any, delta: float) -> np.ndarray:
        x = module.init(list(pose), list(twist), delta)
        return np.asarray(ca.DM(x if own_pose else ca.vertcat(ca.DM(list(pose)), x))).ravel()

    steering = about["commands"][0]
    return Predictor(
        name, module.PERIOD_S, states, ca.Function("step", [z, u], [z_next]), init,
        (steering["low"], steering["high"]),
    )  # fmt: skip
