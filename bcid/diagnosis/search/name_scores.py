"""What each effect would add beside a remainder, to first order: the score test of a name that nothing else replaces.

A trial is an effect at one size and place, and its column the change of predicted poses by it.  With its amplitude
free and the named parameters projected out, the evidence of trial and remainder together is compared with that of the
remainder alone, whose spreads are found anew beside the trial.
"""

import itertools
from collections.abc import Mapping, Sequence

import numpy as np

from bcid.aliases import Floats
from bcid.diagnosis.kept_steps import kept_under
from bcid.diagnosis.remainder.evidence import Quadratic
from bcid.diagnosis.remainder.fit import RemainderFit
from bcid.diagnosis.remainder.functions import RemainderBasis, channel_of
from bcid.diagnosis.remainder.information import TakeInformation, gather_information
from bcid.diagnosis.search.screen import CandidateEffect, combine_vectors
from bcid.effects.table import ENTRIES
from bcid.likelihood.limits import LIKELIHOOD_LIMITS
from bcid.likelihood.price import price_nats
from bcid.likelihood.refit import Fit
from bcid.likelihood.score_test import TrialChanges
from bcid.likelihood.take import N_NUISANCE, Take


@kept_under()
def score_names(rest: RemainderFit, take: Take, trials: TrialChanges) -> list[CandidateEffect]:
    """The effects of the `trials` by the evidence (nats) that each adds beside the fit and its remainder, best first.

    To first order, about the fit with the remainder and about that without it; the greater counts.  Beside a remainder
    the pushes are small, so that exchanging it for a large effect is far from linear; without it the fit may be far
    from where a small effect belongs.
    """
    seen = rest.seen
    none = np.zeros(len(seen.basis.size))
    without = gather_information(rest.named, take, seen.basis, none)
    found = _score_about(rest.named, without, seen.weights, seen.basis, seen.spread, take, trials)
    if rest.fit is not rest.named:
        beside = gather_information(rest.fit, take, rest.basis, rest.fitted)
        more = _score_about(rest.fit, beside, beside.robust_weights, rest.basis, rest.spread, take, trials)
        found = {
            name: max((c[name] for c in (found, more) if name in c), key=lambda c: c.score) for name in found | more
        }
    return sorted(found.values(), key=lambda c: -c.score)


def _score_about(
    fit: Fit, at: TakeInformation, weights: Floats, basis: RemainderBasis, spread: Mapping[str, float], take: Take,
    trials: TrialChanges,
) -> dict[str, CandidateEffect]:  # fmt: skip
    """The effects of the `trials` by the evidence (nats) that each adds, to first order about one fit."""
    g, G = _products_with_trials(at, trials.columns / fit.scales.r[:, None], weights)
    n, K = fit.hypothesis.named_size, len(basis.size)
    answer = np.linalg.lstsq(G[:n, :n], G[:n, n:], rcond=1e-12)[0]
    b, H = g[n:] - answer.T @ g[:n], G[n:, n:] - G[n:, :n] @ answer
    alone = Quadratic(b[:K], H[:K, :K])
    nothing = alone.log_evidence(basis.sd(spread))
    best = dict[str, CandidateEffect]()
    for trial in trials.trials:
        own = slice(K + trial.own.start, K + trial.own.stop)
        own_H, own_b = H[own, own], b[own]
        if (np.diag(own_H) < LIKELIHOOD_LIMITS.min_information).any():
            continue
        taken = np.linalg.lstsq(own_H, H[own, :K], rcond=1e-9)[0]
        amplitude = np.linalg.lstsq(own_H, own_b, rcond=1e-9)[0]
        beside = Quadratic(b[:K] - taken.T @ own_b, H[:K, :K] - H[own, :K].T @ taken)
        own_channel = str(ENTRIES[trial.effect].channel)
        others = {name: 0.0 if channel_of(name) == own_channel else tau for name, tau in spread.items()}
        again = _best_of(beside, basis, [spread, others, dict.fromkeys(spread, 0.0)])
        c = beside.posterior_mean(basis.sd(again))
        amplitude = amplitude - taken @ c
        score = 0.5 * float(own_b @ np.linalg.lstsq(own_H, own_b, rcond=1e-9)[0])
        price = price_nats(len(ENTRIES[trial.effect].parameters), take.segments)
        score += beside.log_evidence(basis.sd(again)) - nothing - price
        values = combine_vectors(trial, amplitude)
        p = ENTRIES[trial.effect].parameters
        if any(not q.is_place and q.low >= 0.0 and v <= 0.0 for q, v in zip(p, values, strict=True)):
            # the other sign would do better, and is none that the effect has
            score, values = -price, [v if q.is_place else q.off for q, v in zip(p, values, strict=True)]
        if trial.effect not in best or score > best[trial.effect].score:
            best[trial.effect] = CandidateEffect(trial.effect, values, score)
    return best


def _best_of(
    quadratic: Quadratic, basis: RemainderBasis, spreads: Sequence[Mapping[str, float]]
) -> Mapping[str, float]:
    """That of the `spreads` with the greatest evidence."""
    return max(spreads, key=lambda s: quadratic.log_evidence(basis.sd(s)))


def _products_with_trials(at: TakeInformation, columns: Floats, weights: Floats) -> tuple[Floats, Floats]:
    """Slope (m,) and information (m, m) of n names, K coefficients and T trials, whose `columns` are over the noise.

    Initial states and pushes are projected out; the names' prior is included.
    """
    slope_n, slope_c, G_n, G_nc, G_c = at.weigh(weights)
    n, K, T = len(slope_n), len(slope_c), columns.shape[2]
    to_names, to_carriers = np.zeros((n, T)), np.zeros((K, T))
    among, slope = np.zeros((T, T)), np.zeros(T)
    roots = at.terms.root
    for s, (a, b) in enumerate(itertools.pairwise(at.first)):
        own, mine = at.rows[a:b].reshape(-1, at.rows.shape[2]), columns[a:b].reshape(-1, T)
        A, rest = own[:, :N_NUISANCE], own[:, N_NUISANCE:]
        free, free_T = roots[s] @ (A.T @ rest), roots[s] @ (A.T @ mine)
        products = rest.T @ mine - free.T @ free_T
        to_names += weights[s] * products[:n]
        to_carriers += weights[s] * (at.values[s].T @ products[n:-1])
        slope += weights[s] * products[-1]
        among += weights[s] * (mine.T @ mine - free_T.T @ free_T)
    G = np.block([[G_n, G_nc, to_names], [G_nc.T, G_c, to_carriers], [to_names.T, to_carriers.T, among]])
    return np.r_[slope_n, slope_c, slope + to_carriers.T @ at.c], G  # all about no functions
