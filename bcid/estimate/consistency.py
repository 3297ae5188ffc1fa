"""Whether the filter is honest: NIS against its chi-squared band, and NEES and RMSE against a simulation's truth."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from bcid.aliases import Bools, Floats
from bcid.documents.document import Document, Part
from bcid.estimate.limits import LIMITS


class NisSummary(Part):
    """Normalised innovation squared (NIS) of a filter's updates, chi-squared when the filter is honest."""

    mean_per_dof: float  # 1 when honest
    band95: tuple[float, float]  # where the mean of an honest filter lies with 95 % probability
    share_inside_95: float  # of the updates, each in its own 95 % band
    updates: int

    @property
    def plausible(self) -> bool:
        """Whether the assumed noise fits the take: the mean per measured quantity is near 1."""
        low, high = LIMITS.plausible_nis
        return low < self.mean_per_dof < high


class RmseByState(Part):
    """Root mean square error of each estimated quantity, in SI units."""

    v_x: float
    v_y: float
    yaw_rate: float
    v_f: float
    alpha_f: float
    alpha_r: float


class NeesSummary(Part):
    """Normalised estimation error squared (NEES) of the twist: 3 when its covariance is honest, less when cautious."""

    mean: float
    median: float
    band95: tuple[float, float]  # where the mean of as many independent rows lies with 95 % probability
    rows: int
    left_out: int  # rows near v_x = 0, where the covariance is singular


class TruthCheck(Document):
    """The estimator's errors on a simulated take (check.json)."""

    name: str
    rmse: RmseByState
    nees_smoother: NeesSummary
    nees_filter: NeesSummary


class Truth(NamedTuple):
    """The true motion of a simulated take."""

    time_s: Floats  # (K,)
    twist: Floats  # (K, 3)
    kinematic: Floats  # (K, 4)

    def align_to(self, time_s: Floats) -> tuple[Truth, Bools]:
        """The truth at those of `time_s` (K,) at which it is known to 1e-6 s, and which of them (K,) these are."""
        rows = np.minimum(np.searchsorted(self.time_s, time_s - 1e-6), len(self.time_s) - 1)
        known = np.abs(self.time_s[rows] - time_s) < 1e-6
        return Truth(time_s[known], self.twist[rows[known]], self.kinematic[rows[known]]), known


def _mean_band(dof: float, count: float) -> tuple[float, float]:
    """95 % band (low, high) of S / count, where S is chi-squared distributed with `dof` degrees of freedom."""
    from scipy.stats import chi2

    return float(chi2.ppf(0.025, dof)) / count, float(chi2.ppf(0.975, dof)) / count


def summarise_nis(nis: Floats, dof: Floats) -> NisSummary:
    """The normalised innovation squared (NIS) of a filter's updates, compared with its chi-squared distribution.

    `nis` (M,) and `dof` (M,), the number of quantities measured, are by event; events that measured nothing (dof = 0)
    are left out.  The summary holds the NIS per measured quantity (1 is ideal), the 95 % band of that mean, and the
    share of updates inside their own 95 % bands.
    """
    from scipy.stats import chi2

    used = dof > 0
    total = float(dof[used].sum())
    inside = (nis[used] > chi2.ppf(0.025, dof[used])) & (nis[used] < chi2.ppf(0.975, dof[used]))
    return NisSummary(
        mean_per_dof=float(nis[used].sum() / total),
        band95=_mean_band(total, total),
        share_inside_95=float(inside.mean()),
        updates=int(used.sum()),
    )


def rmse_by_state(twist: Floats, kinematic: Floats, truth: Truth) -> RmseByState:
    """Root mean square errors (RMSE) of an estimated motion against a simulation's true one, by quantity, in SI units.

    `twist` (K, 3) holds v_x, v_y, yaw rate and `kinematic` (K, 4) v_f, alpha_f, alpha_r, delta (not scored), row by row
    as in `truth`.  Slip-angle errors are wrapped to +-pi and taken where the true |v_x| exceeds
    `LIMITS.min_slip_speed_mps` only (docs/errata.md row 15).
    """
    error, slip = twist - truth.twist, kinematic - truth.kinematic
    v_x, v_y, yaw_rate = np.sqrt((error**2).mean(axis=0)).tolist()
    rolling = _mark_rolling_rows(truth)
    wrapped = (np.angle(np.exp(1j * slip[rolling, column])) for column in (1, 2))
    v_f, alpha_f, alpha_r = (float(np.sqrt((e**2).mean())) for e in (slip[:, 0], *wrapped))
    return RmseByState(v_x=v_x, v_y=v_y, yaw_rate=yaw_rate, v_f=v_f, alpha_f=alpha_f, alpha_r=alpha_r)


def _mark_rolling_rows(truth: Truth) -> Bools:
    """Mask (K,) of rows where the true |v_x| exceeds `LIMITS.min_slip_speed_mps`, so that slip angles are defined."""
    return np.asarray(np.abs(truth.twist[:, 0]) > LIMITS.min_slip_speed_mps)


def summarise_nees(twist: Floats, covariance: Floats, truth: Truth) -> NeesSummary:
    """Mean, 95 % band and median of the normalised estimation error squared (NEES) e^T P^-1 e; 3 is its ideal mean.

    e is the error of the twist (K, 3) v_x, v_y, yaw rate against `truth`, and P (K, 3, 3) its stated `covariance`.
    Rows with a true |v_x| up to `LIMITS.min_slip_speed_mps`, where P is singular, are left out and counted.
    """
    error, rolling = twist - truth.twist, _mark_rolling_rows(truth)
    solved = np.linalg.solve(covariance[rolling], error[rolling][:, :, None])[:, :, 0]
    nees, n = np.einsum("ki,ki->k", error[rolling], solved), int(rolling.sum())
    mean, median = float(nees.mean()), float(np.median(nees))
    return NeesSummary(mean=mean, median=median, band95=_mean_band(3 * n, n), rows=n, left_out=int((~rolling).sum()))
