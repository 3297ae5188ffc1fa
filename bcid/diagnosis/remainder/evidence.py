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
from bcid.diagnosis.remainder.functions import RemainderBasis, channel_of, is_copy

SPREADS = (0.0, *np.geomspace(1e-3, 3.0, 15).tolist())
"""Spreads of a channel that are compared, in m/s^2."""

ROUNDS, MIN_ROUND_NATS = 4, 0.1


class Quadratic(NamedTuple):
    """The log-likelihood b . c - c . G c / 2 of a remainder's coefficients, beside all that is fitted."""

    b: Floats  # (K,)
    G: Floats  # (K, K)

    def gain(self, c: Floats) -> float:
        """The log-likelihood with the coefficients `c` (K,), less that with none."""
        return float(self.b @ c - 0.5 * c @ self.G @ c)

    def log_evidence(self, sd: Floats) -> float:
        """Nats by which coefficients with the prior standard deviations `sd` (K,) make the take likelier than none."""
        on = np.flatnonzero(sd)
        if not len(on):
            return 0.0
        root = np.linalg.cholesky(self.whiten(on, sd))
        y = np.linalg.solve(root, sd[on] * self.b[on])
        return 0.5 * float(y @ y) - float(np.log(np.diag(root)).sum())

    def posterior_mean(self, sd: Floats) -> Floats:
        """The likeliest coefficients (K,), with the prior standard deviations `sd` (K,)."""
        on, c = np.flatnonzero(sd), np.zeros(len(sd))
        if len(on):
            c[on] = sd[on] * np.linalg.solve(self.whiten(on, sd), sd[on] * self.b[on])
        return c

    def posterior_covariance(self, sd: Floats) -> Floats:
        """(G + T^-1)^-1 (K, K) of the coefficients, with the prior standard deviations `sd` (K,); 0 where that is 0."""
        on, out = np.flatnonzero(sd), np.zeros_like(self.G)
        if len(on):
            out[np.ix_(on, on)] = sd[on][:, None] * np.linalg.inv(self.whiten(on, sd)) * sd[on]
        return out

    def whiten(self, on: Ints, sd: Floats) -> Floats:
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
    member = np.array(basis.channel)
    for _ in range(ROUNDS):
        gained = 0.0
        for name in channels:
            nats = _evidence_by_spread(quadratic, basis, spread, np.flatnonzero(member == name))
            nats = nats - basis.prices.get(name, 0.0) * (np.array(SPREADS) > 0.0)
            k, before = int(np.argmax(nats)), nats[SPREADS.index(spread[name])]
            if nats[k] > before:
                spread[name], gained = SPREADS[k], gained + nats[k] - before
        if gained < MIN_ROUND_NATS:
            break
    return spread


def _evidence_by_spread(quadratic: Quadratic, basis: RemainderBasis, spread: Mapping[str, float], own: Ints) -> Floats:
    """Nats that the functions `own` of one channel add beside the others, by each of SPREADS.

    With the others integrated out and c = size x, the log-likelihood b . x - x . G x / 2 has G = U diag(lambda) U^T;
    with beta = U^T b, E(tau) = sum tau^2 beta^2 / (1 + lambda tau^2) / 2 - log(1 + lambda tau^2) / 2.
    """
    sd = basis.sd(spread)
    sd[own] = 0.0
    others, size = np.flatnonzero(sd), basis.size[own]
    b, G = quadratic.b[own], quadratic.G[np.ix_(own, own)]
    if len(others):
        root = np.linalg.cholesky(quadratic.whiten(others, sd))
        both = np.column_stack([quadratic.G[np.ix_(others, own)], quadratic.b[others]]) * sd[others][:, None]
        taken = np.linalg.solve(root, both)
        b, G = b - taken[:, :-1].T @ taken[:, -1], G - taken[:, :-1].T @ taken[:, :-1]
    values, U = np.linalg.eigh(size[:, None] * G * size)
    beta, tau2 = U.T @ (size * b), np.square(SPREADS)[:, None]
    grown = 1.0 + np.maximum(values, 0.0) * tau2
    return np.asarray((0.5 * tau2 * beta**2 / grown - 0.5 * np.log(grown)).sum(axis=1))


def channel_worths(quadratic: Quadratic, basis: RemainderBasis, spread: Mapping[str, float]) -> dict[str, float]:
    """Nats that each channel's functions add beside those of the others, whose spreads are found again; most first.

    A channel's waves (~) and constants (=) count as its own.
    """
    whole = quadratic.log_evidence(basis.sd(spread)) - basis.price(spread)
    worths = {}
    for name in {channel_of(n) for n, tau in spread.items() if tau > 0.0}:
        others = [n for n in basis.channels if channel_of(n) != name and (spread[n] > 0.0 or not is_copy(n))]
        without = likeliest_spreads(quadratic, basis, others, spread)
        # spreads are found one after the other: without a channel they may end at a greater maximum
        less = quadratic.log_evidence(basis.sd(without)) - basis.price(without)
        worths[name] = max(whole - less, 0.0)
    return dict(sorted(worths.items(), key=lambda item: -item[1]))
