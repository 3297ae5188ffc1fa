"""What the baselines regress disturbances on: quantities of state, place and time at each 0.5 s, and folds in time."""

import numpy as np

from bcid.aliases import Floats, Ints
from bcid.diagnosis.locate.pushes import Disturbances

FOLDS = 4
BLOCK_KNOTS = 30  # 15 s: neighbours are alike


def regressor_columns(disturbances: Disturbances) -> dict[str, Floats]:
    """Regressors for the disturbances at K knots of 0.5 s, by their names in diagnosis.json ("speed", "steering" ...).

    Each is an array (K, n): n = 1 but for "throttle" (u_m and motor force F_m), "place" (x, y) and "heading" (sine,
    cosine), where n = 2.
    """
    m = disturbances.states
    single = {
        "v_x": m["v_x"], "v_y": m["v_y"], "speed": np.hypot(m["v_x"], m["v_y"]), "yaw_rate": m["omega"],
        "steering": m["delta"], "steering_rate": m["delta_rate"], "throttle": np.maximum(m["u_m"], 0.0),
        "braking": np.minimum(m["u_m"], 0.0), "alpha_f": m["alpha_f"], "alpha_r": m["alpha_r"],
    }  # fmt: skip
    columns = {name: v[:, None] for name, v in single.items()}
    columns["throttle"] = np.column_stack([single["throttle"], m["F_m"]])
    columns["place"] = np.column_stack([m["p_x"], m["p_y"]])
    columns["heading"] = np.column_stack([np.sin(m["theta"]), np.cos(m["theta"])])
    columns["time"] = disturbances.time_s[:, None]
    return columns


def blocked_folds(knots: int) -> Ints:
    """Number of the cross-validation fold, 0 to FOLDS - 1, of each of `knots` consecutive samples: shape (knots,).

    Blocks of BLOCK_KNOTS samples are given to the folds in turn, as neighbouring samples are correlated; blocks are
    shorter, knots // FOLDS, where that is less.
    """
    block = min(BLOCK_KNOTS, knots // FOLDS)
    return np.asarray((np.arange(knots) // block) % FOLDS)
