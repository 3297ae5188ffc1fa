"""Is the filter honest?  NIS against its chi-squared band; on simulated takes NEES and RMSE against truth."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from bcid.aliases import Floats

SINGULAR_MPS = 0.1  # alpha_r is masked below this |v_x| (errata 15)


class Truth(NamedTuple):
    """The simulated motion."""

    time_s: Floats  # (K,)
    twist: Floats  # (K, 3)
    kinematic: Floats  # (K, 4)

    def at(self, time_s: Floats) -> tuple[Truth, npt.NDArray[np.bool_]]:
        """The truth at those of `time_s` where there is one, and which these are."""
        rows = np.minimum(np.searchsorted(self.time_s, time_s - 1e-6), len(self.time_s) - 1)
        known = np.abs(self.time_s[rows] - time_s) < 1e-6
        return Truth(time_s[known], self.twist[rows[known]], self.kinematic[rows[known]]), known


def nis_facts(nis: Floats, dof: Floats) -> dict[str, Any]:
    """Mean NIS per measured quantity with its 95 % band, and the share of updates inside their own band."""
    from scipy.stats import chi2

    used = dof > 0
    total = float(dof[used].sum())
    low, high = (float(chi2.ppf(p, total)) / total for p in (0.025, 0.975))
    inside = (nis[used] > chi2.ppf(0.025, dof[used])) & (nis[used] < chi2.ppf(0.975, dof[used]))
    return {
        "mean_per_dof": float(nis[used].sum() / total),
        "band95": [low, high],
        "share_inside_95": float(inside.mean()),
        "updates": int(used.sum()),
    }


def rmse_facts(twist: Floats, kinematic: Floats, truth: Truth) -> dict[str, float]:
    """RMSE of v_x, v_y, yaw rate, v_f, alpha_f, alpha_r; slip angles where |v_x| is not near zero."""
    error, slip = twist - truth.twist, kinematic - truth.kinematic
    rmse = dict(zip(("v_x", "v_y", "yaw_rate"), np.sqrt((error**2).mean(axis=0)).tolist(), strict=True))
    rolling = np.abs(truth.twist[:, 0]) > SINGULAR_MPS
    rmse["v_f"] = float(np.sqrt((slip[:, 0] ** 2).mean()))
    for column, name in ((1, "alpha_f"), (2, "alpha_r")):
        wrapped = np.angle(np.exp(1j * slip[rolling, column]))
        rmse[name] = float(np.sqrt((wrapped**2).mean()))
    return rmse


def nees_facts(twist: Floats, covariance: Floats, truth: Truth) -> dict[str, Any]:
    """Mean NEES of the twist with the 95 % band of as many independent ones; 3 when honest, less when cautious.

    Near v_x = 0 and at standstill the heading angles are not observable and the twist's covariance is
    singular: those rows are left out and counted.
    """
    from scipy.stats import chi2

    error = twist - truth.twist
    rolling = np.abs(truth.twist[:, 0]) > SINGULAR_MPS
    solved = np.linalg.solve(covariance[rolling], error[rolling][:, :, None])[:, :, 0]
    nees, n = np.einsum("ki,ki->k", error[rolling], solved), int(rolling.sum())
    return {
        "mean": float(nees.mean()), "median": float(np.median(nees)), "expected": 3.0,
        "band95": [float(chi2.ppf(p, 3 * n)) / n for p in (0.025, 0.975)],
        "rows": n, "left_out": int((~rolling).sum()),
    }  # fmt: skip
