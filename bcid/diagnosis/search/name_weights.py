"""What names are worth on a take: by how much each makes it likelier beside a remainder that may take its place.

Beside the names stands a remainder, whose size is found by evidence.  A name counts by what is lost without it, the
remainder found anew; what the remainder still explains beside all names is unknown.  The method as equations:
docs/method.md.
"""

import math
from dataclasses import dataclass, field
from typing import NamedTuple

from bcid.diagnosis.limits import SEARCH_LIMITS
from bcid.diagnosis.remainder.fit import (
    Explained,
    RemainderFit,
    explain,
    explain_with_copies,
    fit_with_remainder,
)
from bcid.diagnosis.remainder.functions import CHANNELS, RemainderBasis, is_copy
from bcid.diagnosis.search.refits import gain_nats, named_effects, refit_with_effects
from bcid.diagnosis.search.screen import NO_NULLS, NullGains, sample_null_gains, simulate_trials
from bcid.likelihood.newton import MIN_GAIN
from bcid.likelihood.refit import Fit
from bcid.likelihood.score_test import TrialChanges
from bcid.likelihood.take import Take


class KeptNames(NamedTuple):
    """The names that count, and what shows that."""

    rest: RemainderFit  # the fit with them, and what is missing beside them
    gains: dict[str, float]  # nats by which each makes the take likelier, beside the remainder and without it
    without: dict[str, Fit]  # the refit without each


@dataclass
class NameWeights:
    """What names are worth on a take: what does not change, and what was found so far."""

    take: Take
    basis: RemainderBasis
    trials: TrialChanges
    excluded: tuple[str, ...]
    trials_beside: tuple[str, ...]  # effects beside which these trials are
    nulls: NullGains = NO_NULLS
    tried: dict[frozenset[str], RemainderFit] = field(default_factory=dict)
    refused: dict[str, float] = field(default_factory=dict)

    @property
    def gate(self) -> float:
        """Nats that a name must add."""
        return self.nulls.gate

    def draw_nulls(self, rest: RemainderFit) -> None:
        """Find what effects gain by chance beside a fit and its remainder.

        Chance has nothing to do with what is missing, which the remainder has taken up; what it follows badly seems to
        be chance as long as it has no name.
        """
        self.nulls = sample_null_gains(rest.fit, self.take, self.trials_for(rest.named))

    def trials_for(self, fit: Fit) -> TrialChanges:
        """Changes of predicted poses by every effect that `fit` lacks and that is not refused or excluded."""
        if fit.hypothesis.effects != self.trials_beside:
            self.trials = simulate_trials(fit, self.take).without(self.excluded)
            self.trials_beside = fit.hypothesis.effects
        return self.trials.without((*fit.hypothesis.effects, *self.refused))

    def explain(self, fit: Fit) -> Explained:
        """What a remainder explains beside a `fit` to first order."""
        known = self._known(fit)
        return known.seen if known else explain(fit, self.take, self.basis)

    def beside_remainder(self, fit: Fit, seen: Explained | None = None, to_exceed: float = -math.inf) -> RemainderFit:
        """The fit with the remainder of greatest evidence beside it; `seen` is what it explains to first order.

        Refits end where their evidence cannot reach `to_exceed`.
        """
        seen = seen or self.explain(fit)
        return self._known(fit) or self.remember(fit_with_remainder(fit, self.take, seen, to_exceed=to_exceed))

    def _known(self, fit: Fit) -> RemainderFit | None:
        """What was found beside the same effects, if the `fit` is no likelier than the one that it was found of."""
        known = self.tried.get(frozenset(fit.hypothesis.effects))
        return known if known and gain_nats(fit, known.named) < MIN_GAIN else None

    def remember(self, weighed: RemainderFit) -> RemainderFit:
        """The fit of greatest evidence with the effects of the one `weighed`, which is kept."""
        key = frozenset(weighed.named.hypothesis.effects)
        if not weighed.settled:
            return weighed
        self.tried[key] = greater_evidence(self.tried.get(key), weighed)
        return self.tried[key]

    def keep_names(self, rest: RemainderFit) -> KeptNames:
        """Those names of a fit that each add more than the gate; the least goes first.

        A name must add more than the share of the remainder, too, that smooth functions cannot follow.  The remainder
        beside the names may hold copies of laws that have names.
        """
        while True:
            without, full = self._without_each(rest), self._with_copies(rest)
            gains = {name: self._gain(rest, full, less) for name, less in without.items()}
            required = max(self.gate, SEARCH_LIMITS.remainder_error * full.nats)
            weakest = min(gains, key=lambda n: gains[n], default="")
            if not weakest or gains[weakest] > required:
                return KeptNames(full, gains, {name: less.named for name, less in without.items()})
            self.refused[weakest] = gains[weakest]
            rest = self.beside_remainder(without[weakest].named)

    def _gain(self, rest: RemainderFit, full: RemainderFit, less: RemainderFit) -> float:
        """Nats by which a name makes the take likelier, by the fit `less` it: the least of three comparisons.

        What helps only beside a remainder, or only without one, is no name.  Where a channel is needed beside all
        names, the copies of laws in it may take the name's place; elsewhere they may not, as no name could win.
        """
        gain = min(rest.log_evidence - less.log_evidence, gain_nats(rest.named, less.named))
        least = max(self.gate, SEARCH_LIMITS.needed_share * gain)
        needed = tuple(c for c, nats in full.seen.channel_nats().items() if nats > least) if full.nats > least else ()
        if gain < self.gate or not needed:
            return gain
        seen = explain(less.named, self.take, self.basis, needed)
        beside = fit_with_remainder(less.named, self.take, seen, needed)
        return min(gain, full.log_evidence - max(beside.log_evidence, less.log_evidence))

    def _with_copies(self, rest: RemainderFit) -> RemainderFit:
        """The fit `rest`, or that with copies of laws that have names in its remainder, if that is likelier."""
        seen = explain_with_copies(rest.seen, rest.named, self.take)
        if not any(tau > 0.0 for name, tau in seen.spread.items() if is_copy(name)):
            return rest
        return greater_evidence(rest, fit_with_remainder(rest.named, self.take, seen, CHANNELS))

    def _without_each(self, rest: RemainderFit) -> dict[str, RemainderFit]:
        """For each name the refit without it, with a remainder beside it.

        It starts from the fit with the name: what was found before may be a lesser maximum.
        """
        held = rest.named.hypothesis.effects
        less = {name: tuple(n for n in held if n != name) for name in named_effects(rest.named)}
        return {
            name: self.beside_remainder(refit_with_effects(rest.named, self.take, others))
            for name, others in less.items()
        }


def greater_evidence(one: RemainderFit | None, other: RemainderFit) -> RemainderFit:
    """The fit of greater evidence of two."""
    return other if one is None or other.log_evidence > one.log_evidence else one
