"""What a search for names has found so far: what each set of names is worth, and what chance reaches beside it.

Beside names stands a remainder, whose size is found by evidence.  For each set of names the greatest evidence is kept,
and the likeliest fit without a remainder.
"""

import math
from collections.abc import Callable, Hashable, Mapping
from dataclasses import dataclass, field
from typing import TypeVar

from bcid.diagnosis.limits import SEARCH_LIMITS
from bcid.diagnosis.remainder.explain import Explained, explain
from bcid.diagnosis.remainder.fit import RemainderFit, allow_copies, fit_with_remainder
from bcid.diagnosis.remainder.functions import RemainderBasis
from bcid.diagnosis.search.refits import refit_from_large_sizes
from bcid.diagnosis.search.screen import NO_NULLS, NullGains, sample_null_gains, simulate_trials
from bcid.likelihood.divergence import none_if_diverged
from bcid.likelihood.refit import Fit, evaluate_fixed
from bcid.likelihood.refit_state import MIN_GAIN
from bcid.likelihood.score_test import TrialChanges
from bcid.likelihood.take import Take

Key = TypeVar("Key", bound=Hashable)
Made = TypeVar("Made")


@dataclass
class SearchState:
    """A search on one take: what does not change, and what was found so far, by the sets of effects of fits."""

    take: Take
    basis: RemainderBasis
    excluded: tuple[str, ...]  # effects that must not be named
    nulls: NullGains = NO_NULLS  # what effects gain by chance beside the fit that the search has reached
    given: Fit | None = None  # the simulation as it is given, if there is one
    weighed: dict[frozenset[str], RemainderFit] = field(default_factory=dict)  # of the greatest evidence
    likeliest: dict[frozenset[str], Fit] = field(default_factory=dict)  # without a remainder
    refused: set[str] = field(default_factory=set)  # effects that are not tried again beside the names there are
    added: dict[str, float] = field(default_factory=dict)  # nats that effects added which were tried, or taken, in vain
    _weighed_from: dict[frozenset[str], float] = field(default_factory=dict)  # log-likelihoods of the fits weighed
    _begun_at_given: dict[frozenset[str], float] = field(default_factory=dict)  # likewise, of those from the simulation
    _explained: dict[frozenset[str], tuple[Fit, Explained]] = field(default_factory=dict)  # the last fit of each
    _trials: dict[frozenset[str], TrialChanges] = field(default_factory=dict)
    _nulls: dict[frozenset[str], NullGains] = field(default_factory=dict)
    _gates: dict[str, float] = field(default_factory=dict)  # of effects, when last drawn beside a fit that lacks them
    _from_large_sizes: dict[frozenset[str], tuple[Fit, list[Fit]]] = field(default_factory=dict)
    _with_copies: dict[tuple[frozenset[str], tuple[str, ...]], tuple[Fit, RemainderFit]] = field(default_factory=dict)

    @property
    def gate(self) -> float:
        """Nats that hardly anything adds by chance."""
        return self.nulls.gate

    def gate_of(self, *names: str) -> float:
        """Nats that each of the effects with these names must add, or the one that must add most of several."""
        return max((self._gates.get(name, self.gate) for name in names), default=self.gate)

    def gate_of_held(self, name: str) -> float:
        """Nats that a name must add which the fit at hand holds: no more than hardly anything adds beside all names.

        Its own gate was drawn beside a fit that lacked it, and mostly more, which then passes for chance.
        """
        return min(self.gate_of(name), self.gate)

    def required_nats(self, unnamed: float, *names: str) -> float:
        """Nats that `names` must add beside a remainder of so many nats: smooth functions cannot follow a share of it.

        So much is no name's.
        """
        return max(self.gate_of(*names), SEARCH_LIMITS.remainder_error * unnamed)

    def tell_added(self, added: Mapping[str, float]) -> None:
        """Keep the nats that effects `added` in vain; those below their gates are not tried again.

        What passes its gate may count beside less that has no name.
        """
        self.added |= added
        self.refused |= {name for name, nats in added.items() if nats < self.gate_of(name)}

    def draw_nulls(self, rest: RemainderFit) -> None:
        """Find what effects gain by chance beside a fit and its remainder.

        Chance has nothing to do with what is missing, which the remainder has taken up; what it follows badly seems to
        be chance as long as it has no name.
        """
        key = effects_of(rest.named)
        if key not in self._nulls:
            self._nulls[key] = sample_null_gains(rest.fit, self.take, self.trials_beside(rest.named))
        self.nulls = self._nulls[key]
        self._gates |= {name: self.nulls.gate_of(name) for name in self.nulls.levels}

    def trials_beside(self, fit: Fit) -> TrialChanges:
        """Changes of predicted poses by every effect that `fit` lacks and that is not excluded."""
        key = effects_of(fit)
        if key not in self._trials:
            # those beside other fits are not needed again, and large
            self._trials = {key: simulate_trials(fit, self.take).without((*self.excluded, *key))}
        return self._trials[key]

    def from_large_sizes(self, fit: Fit) -> list[Fit]:
        """The refits of `fit` with an effect more that a refitted base model takes up, but for those excluded."""
        kept = self._from_large_sizes
        return _made_once(kept, effects_of(fit), fit, lambda: refit_from_large_sizes(fit, self.take, self.excluded))

    def explain(self, fit: Fit) -> Explained:
        """What a remainder explains beside a `fit` to first order."""
        return _made_once(self._explained, effects_of(fit), fit, lambda: explain(fit, self.take, self.basis))

    def with_own_view(self, rest: RemainderFit) -> RemainderFit:
        """The fit with what is seen beside its own names, where it has come from a fit of others."""
        if frozenset(rest.seen.effects) == effects_of(rest.named):
            return rest
        return self.remember(rest._replace(seen=self.explain(rest.named)))

    def beside_remainder(self, fit: Fit, to_exceed: float = -math.inf) -> RemainderFit:
        """The fit with the remainder of greatest evidence beside it.

        Refits end where their evidence cannot reach `to_exceed`.  What is known of a fit that is as likely is returned.
        """
        known = self._already_weighed(fit)
        if known:
            return known
        key = effects_of(fit)
        self.keep_likeliest(fit)
        found = fit_with_remainder(fit, self.take, self.explain(fit), to_exceed=to_exceed)
        if found.settled:
            self._weighed_from[key] = max(_likelihood(fit), self._weighed_from.get(key, -math.inf))
        return self.remember(found)

    def weigh_anew(self, fit: Fit, to_exceed: float = -math.inf) -> RemainderFit:
        """The fit with a remainder found from nothing, beside itself and beside the simulation as it is given.

        The greater evidence of the two stands.
        """
        return self.beside_remainder_from_given(self.beside_remainder(fit, to_exceed), to_exceed)

    def beside_remainder_from_given(self, rest: RemainderFit, to_exceed: float = -math.inf) -> RemainderFit:
        """The fit `rest`, or the likelier one that begins at the simulation as it is given, in place of its refit.

        It is `rest` where there is no simulation.  A refit without a remainder may have moved the parameters of the
        simulation far, to do what has no name.  Fits that have begun there already are not found once more, but where
        they are likelier now.
        """
        given, key, likelihood = self.given, effects_of(rest.named), _likelihood(rest.named)
        if given is None or likelihood - self._begun_at_given.get(key, -math.inf) < MIN_GAIN:
            return rest
        hypothesis = rest.named.hypothesis
        values = hypothesis.effect_values(rest.named.phi) | given.hypothesis.effect_values(given.phi)
        phi = hypothesis.phi_at(given.car(), values)
        start = none_if_diverged(evaluate_fixed, self.take, hypothesis, phi, given.scales)
        if start is None:
            return rest
        found = fit_with_remainder(start, self.take, explain(start, self.take, self.basis), to_exceed=to_exceed)
        if found.settled:
            self._begun_at_given[key] = likelihood
        return greater_evidence(rest, self.remember(found._replace(named=rest.named, seen=rest.seen)))

    def keep_likeliest(self, fit: Fit) -> Fit:
        """The likeliest fit with these effects, without a remainder, of this one and what is kept; it is kept."""
        key = effects_of(fit)
        self.likeliest[key] = max((f for f in (fit, self.likeliest.get(key)) if f), key=_likelihood)
        return self.likeliest[key]

    def _already_weighed(self, fit: Fit) -> RemainderFit | None:
        """The weighed fit that holds the effects of `fit`, if it came of a fit as likely; else None."""
        key = effects_of(fit)
        return self.weighed[key] if _likelihood(fit) - self._weighed_from.get(key, -math.inf) < MIN_GAIN else None

    def remember(self, weighed: RemainderFit) -> RemainderFit:
        """The fit of greatest evidence with these effects, of the one `weighed` and what is kept; it is kept.

        Without the remainder it is the likeliest that is known.
        """
        key = effects_of(weighed.named)
        known = self.weighed.get(key)
        best = known if known and known.log_evidence > weighed.log_evidence else weighed
        likelier = self.likeliest.get(key)
        if likelier and _likelihood(likelier) > _likelihood(best.named):
            best = best._replace(named=likelier)
        if weighed.settled:
            self.weighed[key] = best
        return best

    def with_copies(self, rest: RemainderFit, channels: tuple[str, ...]) -> RemainderFit:
        """The fit `rest`, or that with copies of laws that have names in its remainder, if that is likelier.

        Copies are there in some `channels` only.
        """
        key, kept = (effects_of(rest.named), channels), self._with_copies
        with_them = _made_once(kept, key, rest.fit, lambda: allow_copies(rest, self.take, channels))
        return greater_evidence(rest, with_them)


def effects_of(fit: Fit) -> frozenset[str]:
    """The effects that a fit holds, by which it is kept."""
    return frozenset(fit.hypothesis.effects)


def _made_once(kept: dict[Key, tuple[Fit, Made]], key: Key, fit: Fit, make: Callable[[], Made]) -> Made:
    """What is `kept` under a `key` beside this very `fit`; made anew beside another, and kept instead."""
    if key not in kept or kept[key][0] is not fit:
        kept[key] = fit, make()
    return kept[key][1]


def greater_evidence(one: RemainderFit | None, other: RemainderFit) -> RemainderFit:
    """The fit of greater evidence of two."""
    return other if one is None or other.log_evidence > one.log_evidence else one


def _likelihood(fit: Fit) -> float:
    """What fits without a remainder are compared by."""
    return fit.penalised_log_likelihood
