"""Is the filter honest?  NIS against its chi-squared band; on simulated takes NEES and RMSE against truth."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from bcid.estimate.types import Estimate, Floats

SINGULAR_MPS = 0.1  # alpha_r is masked below this |v_x| (errata 15)


class Truth(NamedTuple):
    """The simulated motion at the estimate's grid rows."""

    twist: Floats  # (K, 3)
    kinematic: Floats  # (K, 4)


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


def truth_facts(estimate: Estimate, covariance: Floats, truth: Truth) -> dict[str, Any]:
    """RMSE of v_x, v_y, yaw rate, v_f, alpha_f, alpha_r and the twist's mean NEES (3 when honest).

    Near v_x = 0 and at standstill the heading angles are not observable and the twist's covariance
    is singular: those rows are left out of the slip angles' RMSE and of the NEES.
    """
    error = estimate.twist - truth.twist
    rolling = np.abs(truth.twist[:, 0]) > SINGULAR_MPS
    nees = np.einsum(
        "ki,ki->k", error[rolling], np.linalg.solve(covariance[rolling], error[rolling][:, :, None])[:, :, 0]
    )
    rmse = dict(zip(("v_x", "v_y", "yaw_rate"), np.sqrt((error**2).mean(axis=0)).tolist(), strict=True))
    slip = estimate.kinematic - truth.kinematic
    rmse["v_f"] = float(np.sqrt((slip[:, 0] ** 2).mean()))
    for column, name in ((1, "alpha_f"), (2, "alpha_r")):
        wrapped = np.angle(np.exp(1j * slip[rolling, column]))
        rmse[name] = float(np.sqrt((wrapped**2).mean()))
    return {
        "rmse": rmse,
        "rows": int(rolling.sum()),
        "nees_mean": float(nees.mean()),
        "nees_median": float(np.median(nees)),
        "nees_expected": 3.0,
    }
