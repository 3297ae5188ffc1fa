"""An exported model as its user finds it: NAME_casadi.py is imported.  Nothing of bcid is needed."""

import importlib.util
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

POSE = ("p_x", "p_y", "theta")
FIRST_OF_MOTION = "v_x"


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
    module: Any  # NAME_casadi.py

    @property
    def motion(self) -> slice:
        """Where v_x, v_y (m/s) and the yaw rate (rad/s) stand in z."""
        first = self.states.index(FIRST_OF_MOTION)
        return slice(first, first + 3)

    def init(self, pose: Any, twist: Any, delta: float) -> np.ndarray:
        """The state z (n,) of a car at `pose` (3,) with a `twist` (3,), its wheel held at `delta` (rad) until now."""
        x = np.asarray(self.module.init(list(pose), list(twist), delta), dtype=float).ravel()
        return x if self.module.STATES[:3] == POSE else np.concatenate([pose, x])


def load_predictor(folder: Path, name: str) -> Predictor:
    """The model that `bcid export MODEL --format casadi --name NAME --out FOLDER` has written.

    Raises:
        ValueError: its poses are of another point than its states' (see "Of which point" in docs/export.md).
    """
    spec = importlib.util.spec_from_file_location(f"{name}_casadi", folder / f"{name}_casadi.py")
    if spec is None or spec.loader is None:
        raise ValueError(f"{folder / name}_casadi.py is no module of Python")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    own_pose = module.STATES[:3] == POSE
    states = tuple(module.STATES) if own_pose else (*POSE, *module.STATES)
    z, u = ca.SX.sym("z", len(states)), ca.SX.sym("u", 2)
    if own_pose:
        z_next, _ = module.step(z, u)
    else:
        first = module.STATES.index(FIRST_OF_MOTION)
        x_next, twist = module.step(z[3:], u)
        z_next = ca.vertcat(module.move(z[:3], z[3 + first : 6 + first], twist), x_next)
    model = Predictor(name, module.PERIOD_S, states, ca.Function("step", [z, u], [z_next]), module)
    somewhere = np.array([0.3, -0.2, 0.7])
    if np.abs(model.init(somewhere, (0.0, 0.0, 0.0), 0.0)[:3] - somewhere).max() > 1e-9:
        raise ValueError(f"{name}: its poses are not of the centre of gravity: export it with --as vehicle")
    return model
