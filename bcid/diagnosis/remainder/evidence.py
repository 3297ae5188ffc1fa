"""How large a remainder is, by evidence: the prior's spread in each channel under which the take is likeliest.

Let the log-likelihood be b . c - c . G c / 2 in the coefficients c, all else that is fitted projected out, and let
c ~ N(0, T) with T = diag(tau_channel^2 size_j^2).  Integrated over c, the take is likelier by

    E(tau) = b . (G + T^-1)^-1 b / 2 - log|1 + T^(1/2) G T^(1/2)| / 2

than with c = 0; tau = 0 costs nothing.  The second term is Occam's: functions that may be large and are not needed
make the take less likely (MacKay 1992; of missing physics Kennedy and O'Hagan 2001).
"""

from collections.abc import Iterable, Mapping
from typing import NamedTuple

import numpy as np

from bcid.aliases import Floats, Ints
from bcid.diagnosis.remainder.functions import RemainderBasis

SPREADS = (0.0, *np.geomspace(1e-3, 3.0, 15).tolist())
"""Spreads of a channel that are compared, in m/s^2."""

ROUNDS, MIN_ROUND_NATS = 4, 0.1


class Quadratic(NamedTuple):
    """The log-likelihood b . c - c . G c / 2 of a remainder's coefficients, beside all that is fitted."""

    b: Floats  # (K,)
    G: Floats  # (K, K)

    def log_evidence(self, sd: Floats) -> float:
        """Nats by which coefficients with the prior standard deviations `sd` (K,) make the take likelier than none."""
        on = np.flatnonzero(sd)
        if not len(on):
            return 0.0
        root = np.linalg.cholesky(self._whitened(on, sd))
        y = np.linalg.solve(root, sd[on] * self.b[on])
        return 0.5 * float(y @ y) - float(np.log(np.diag(root)).sum())

    def posterior_mean(self, sd: Floats) -> Floats:
        """The likeliest coefficients (K,), with the prior standard deviations `sd` (K,)."""
        on, c = np.flatnonzero(sd), np.zeros(len(sd))
        if len(on):
            c[on] = sd[on] * np.linalg.solve(self._whitened(on, sd), sd[on] * self.b[on])
        return c

    def occam_nats(self, sd: Floats) -> float:
        """log|1 + T^(1/2) G T^(1/2)| / 2: what the freedom of the coefficients costs."""
        on = np.flatnonzero(sd)
        return 0.5 * float(np.linalg.slogdet(self._whitened(on, sd))[1]) if len(on) else 0.0

    def _whitened(self, on: Ints, sd: Floats) -> Floats:
        """1 + T^(1/2) G T^(1/2) of the coefficients `on`."""
        s = sd[on]
        return np.asarray(np.eye(len(on)) + s[:, None] * self.G[np.ix_(on, on)] * s)


def likeliest_spreads(
    quadratic: Quadratic, basis: RemainderBasis, channels: Iterable[str], near: Mapping[str, float] | None = None
) -> dict[str, float]:
    """The spread of each channel under which the take is likeliest, of SPREADS; zero for others than `channels`.

    One channel after the other is given its best spread, from those in `near` on, until nothing is gained.
    """
    spread = dict.fromkeys(basis.channels, 0.0) | dict(near or {})
    spread |= {name: 0.0 for name in spread if name not in set(channels)}
    best = quadratic.log_evidence(basis.sd(spread))
    for _ in range(ROUNDS):
        before = best
        for name in channels:
            nats = [quadratic.log_evidence(basis.sd(spread | {name: tau})) for tau in SPREADS]
            k = int(np.argmax(nats))
            if nats[k] > best:
                spread[name], best = SPREADS[k], nats[k]
        if best - before < MIN_ROUND_NATS:
            break
    return spread


def channel_worths(quadratic: Quadratic, basis: RemainderBasis, spread: Mapping[str, float]) -> dict[str, float]:
    """Nats that each channel's functions add beside those of the others, whose spreads are found again; most first."""
    whole, on = quadratic.log_evidence(basis.sd(spread)), [name for name, tau in spread.items() if tau > 0.0]
    worths = {}
    for name in on:
        others = [n for n in on if n != name]
        without = likeliest_spreads(quadratic, basis, others, spread)
        worths[name] = whole - quadratic.log_evidence(basis.sd(without))
    return dict(sorted(worths.items(), key=lambda item: -item[1]))
