"""Fits without a take, and what a remainder adds beside them, for tests of how names are found and weighed."""

import math
from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from bcid.diagnosis.remainder.fit import RemainderFit
from bcid.diagnosis.search import add_names, refits, search_state
from bcid.diagnosis.search.screen import CandidateEffect, NullGains
from bcid.diagnosis.search.search_state import SearchState
from bcid.likelihood.score_test import Trial, TrialChanges

NOTHING: Any = None
NO_FUNCTIONS: Any = ()
GATE = 12.0


def fit(nats: float, *effects: str, each: tuple[float, ...] = (0.0, 0.0)) -> Any:
    """A fit of so much penalised log-likelihood, of which `each` segment has so much."""
    hypothesis = SimpleNamespace(effects=effects, assumed=())
    return SimpleNamespace(hypothesis=hypothesis, penalised_log_likelihood=nats, per_segment=np.array(each))


def explained_by_remainder(
    nats: float = 0.0, channels: dict[str, float] | None = None, *copied: str, beside: Sequence[str] = ()
) -> Any:
    """What a remainder explains: nats in all, by channel, and the channels in which copies of laws are among it.

    It is so `beside` a fit with these effects.
    """
    spread = {f"{channel}=": 1.0 for channel in copied}
    return SimpleNamespace(nats=nats, spread=spread, effects=tuple(beside), channel_nats=lambda: channels or {})


def beside(named: Any, remainder: float = 0.0, seen: Any = None) -> RemainderFit:
    nats = named.penalised_log_likelihood + remainder
    seen = seen or explained_by_remainder(remainder, beside=named.hypothesis.effects)
    return RemainderFit(named, named, NOTHING, NO_FUNCTIONS, NOTHING, {}, nats, seen)


class Evidence:
    """What a remainder adds beside fits, by their effects: to first order, and after refits that count themselves."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, adds: dict[tuple[str, ...], float], **sketch: float) -> None:
        self.adds = {frozenset(effects): nats for effects, nats in adds.items()}
        self.sketch = sketch  # where evidence to first order is another
        self.copies = dict[tuple[str, ...], float]()  # what a remainder adds that holds copies of laws, where they help
        self.seen = dict[tuple[str, ...], Any]()  # what it explains to first order
        self.from_rest = dict[tuple[str, ...], float]()  # evidence that is found from a remainder's own fit
        self.unsettled = set[tuple[str, ...]]()  # effects of fits whose refits end early
        self.to_exceed = dict[tuple[str, ...], float]()
        self.refitted, self.tried_from_rest = list[tuple[str, ...]](), list[tuple[str, ...]]()
        # effects of fits beside which copies helped, and the channels that were allowed
        self.copied = list[tuple[tuple[str, ...], tuple[str, ...]]]()
        monkeypatch.setattr(search_state, "explain", self.explain)
        monkeypatch.setattr(search_state, "fit_with_remainder", self.fit_with_remainder)
        monkeypatch.setattr(search_state, "allow_copies", self.allow_copies)
        monkeypatch.setattr(search_state, "simulate_trials", lambda f, take: trials())
        monkeypatch.setattr(search_state, "sample_null_gains", lambda f, take, changes: chance())
        monkeypatch.setattr(add_names, "add_beside_remainder", self.add_beside_remainder)
        monkeypatch.setattr(add_names, "converge_further", lambda rest, take: rest)
        monkeypatch.setattr(refits, "refit_fully", lambda f, take: f)
        monkeypatch.setattr(refits, "effects_at_bounds", lambda f, take: ())

    def explain(self, f: Any, take: Any, basis: Any) -> Any:
        effects = f.hypothesis.effects
        nats = self.sketch.get("+".join(effects), self.adds.get(frozenset(effects), 0.0))
        return explained_by_remainder(nats, beside=effects)

    def fit_with_remainder(
        self, f: Any, take: Any, seen: Any, copied: tuple[str, ...] = (), to_exceed: float = -math.inf
    ) -> RemainderFit:
        effects = f.hypothesis.effects
        self.refitted.append(effects)
        self.to_exceed[effects] = to_exceed
        found = beside(f, self.adds.get(frozenset(effects), 0.0), seen)
        return found._replace(settled=effects not in self.unsettled)

    def allow_copies(self, rest: RemainderFit, take: Any, copied: tuple[str, ...]) -> RemainderFit:
        effects = rest.named.hypothesis.effects
        if effects not in self.copies:
            return rest
        self.copied.append((effects, copied))
        return beside(rest.named, self.copies[effects], self.seen.get(effects))

    def add_beside_remainder(self, rest: RemainderFit, f: Any, take: Any, to_exceed: float = -math.inf) -> RemainderFit:
        effects = f.hypothesis.effects
        self.tried_from_rest.append(effects)
        self.to_exceed[effects] = to_exceed
        nats = self.from_rest.get(effects, f.penalised_log_likelihood)
        return beside(f, nats - f.penalised_log_likelihood, rest.seen)


def state_of(**more: Any) -> SearchState:
    return SearchState(NOTHING, NOTHING, (), chance(), **more)


def chance(gate: float = GATE) -> NullGains:
    return NullGains(gate, [CandidateEffect("rear_toe", [0.0], 3.0)])


def simulating(monkeypatch: pytest.MonkeyPatch, *names: str) -> list[tuple[str, ...]]:
    """Trials of so many effects beside any fit; the effects of the fits beside which they were simulated."""
    simulated = list[tuple[str, ...]]()

    def simulate(f: Any, take: Any) -> TrialChanges:
        simulated.append(f.hypothesis.effects)
        return trials(*names)

    monkeypatch.setattr(search_state, "simulate_trials", simulate)
    return simulated


def trials(*names: str) -> TrialChanges:
    return TrialChanges(NOTHING, [Trial(name, [], slice(0)) for name in names])
