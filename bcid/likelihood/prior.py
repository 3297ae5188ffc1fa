"""What is known of parameters before a take is seen: normal laws, and Student's t where a figure may be wrong.

A figure that someone has published or measured is mostly as good as they say, and now and then another altogether: a
battery, a floor or a tyre was changed, or it is a misprint.  Student's t says both: within its scale it is as a normal
law, and far from it a figure costs only a few nats more for each doubling, so that no figure is held against what a
take shows.
"""

from typing import NamedTuple

import numpy as np

from bcid.aliases import Floats

# degrees of freedom of Student's t: one figure in 25 is more than 3 scales off, one in 130 more than 5
TRUST_NU = 4.0


class Prior(NamedTuple):
    """Independent laws of the n components of phi: normal where `nu` is infinite, else Student's t."""

    centre: Floats  # (n,)
    precision: Floats  # (n,) one over the squared scale; 0 where nothing is known
    nu: Floats  # (n,) degrees of freedom
    share: Floats  # (n,) by which the log density counts

    @classmethod
    def normal(cls, centre: Floats, precision: Floats) -> "Prior":
        """Independent normal laws about `centre` (n,), of variances 1 / `precision` (n,)."""
        return cls(centre, precision, np.full_like(centre, np.inf), np.ones_like(centre))

    def log_density(self, phi: Floats) -> float:
        """Logarithm of the density at phi, less that at the centre (nats)."""
        square = self.precision * (phi - self.centre) ** 2
        t, nu = np.isfinite(self.nu), np.where(np.isfinite(self.nu), self.nu, 1.0)
        each = np.where(t, 0.5 * (nu + 1.0) * np.log1p(square / nu), 0.5 * square)
        return -float(np.sum(self.share * each))

    def stiffness(self, phi: Floats) -> Floats:
        """Precisions (n,) of the normal laws about the centre with the same slope at phi.

        The log density of Student's t falls off less than theirs, so that a Newton step with them never goes too far.
        """
        square = self.precision * (phi - self.centre) ** 2
        t, nu = np.isfinite(self.nu), np.where(np.isfinite(self.nu), self.nu, 1.0)
        return np.asarray(self.share * self.precision * np.where(t, (nu + 1.0) / (nu + square), 1.0))

    def slope(self, phi: Floats) -> Floats:
        """Gradient (n,) of the log density at phi."""
        return np.asarray(-self.stiffness(phi) * (phi - self.centre))

    def deviations(self, phi: Floats) -> Floats:
        """Scales (n,) by which phi lies above the centre; 0 where nothing is known."""
        return np.asarray(np.sqrt(self.precision) * (phi - self.centre))
