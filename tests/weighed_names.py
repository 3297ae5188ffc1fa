"""Fits without a take, and what a remainder adds beside them, for tests of how names are found and weighed."""

import math
from types import SimpleNamespace
from typing import Any

import pytest

from bcid.diagnosis.remainder.fit import RemainderFit
from bcid.diagnosis.search import add_names, name_weights
from bcid.diagnosis.search.name_weights import NameWeights
from bcid.diagnosis.search.screen import CandidateEffect, NullGains
from bcid.likelihood.score_test import Trial, TrialChanges

NOTHING: Any = None
GATE = 12.0


def fit(nats: float, *effects: str) -> Any:
    hypothesis = SimpleNamespace(effects=effects, assumed=())
    return SimpleNamespace(hypothesis=hypothesis, penalised_log_likelihood=nats)


def explained(nats: float = 0.0, channels: dict[str, float] | None = None, *copied: str) -> Any:
    """What a remainder explains: nats in all, by channel, and the channels in which copies of laws are among it."""
    spread = {f"{channel}=": 1.0 for channel in copied}
    return SimpleNamespace(nats=nats, spread=spread, channel_nats=lambda: channels or {})


def beside(named: Any, remainder: float = 0.0, seen: Any = None) -> RemainderFit:
    nats = named.penalised_log_likelihood + remainder
    return RemainderFit(named, named, NOTHING, NOTHING, NOTHING, {}, nats, seen or explained(remainder))


class Evidence:
    """What a remainder adds beside fits, by their effects: to first order, and after refits that count themselves."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, adds: dict[tuple[str, ...], float], **sketch: float) -> None:
        self.adds = {frozenset(effects): nats for effects, nats in adds.items()}
        self.sketch = sketch  # where evidence to first order is another
        self.seen = dict[tuple[str, ...], Any]()  # what is explained beside some effects, copies of laws among it
        self.copies = dict[tuple[str, ...], float]()  # what a remainder adds that holds such copies
        self.from_rest = dict[tuple[str, ...], float]()  # evidence that is found from a remainder's own fit
        self.to_exceed = dict[tuple[str, ...], float]()
        self.refitted, self.tried_from_rest = list[tuple[str, ...]](), list[tuple[str, ...]]()
        self.copied = list[tuple[tuple[str, ...], tuple[str, ...]]]()
        monkeypatch.setattr(name_weights, "explain", self.explain)
        monkeypatch.setattr(name_weights, "explain_with_copies", self.explain_with_copies)
        monkeypatch.setattr(name_weights, "fit_with_remainder", self.fit_with_remainder)
        monkeypatch.setattr(add_names, "add_beside_remainder", self.add_beside_remainder)

    def explain_with_copies(self, seen: Any, f: Any, take: Any) -> Any:
        return self.seen.get(f.hypothesis.effects, explained())

    def explain(self, f: Any, take: Any, basis: Any, copied: tuple[str, ...] = ()) -> Any:
        effects = f.hypothesis.effects
        return explained(self.sketch.get("+".join(effects), self.adds.get(frozenset(effects), 0.0)))

    def fit_with_remainder(
        self, f: Any, take: Any, seen: Any, copied: tuple[str, ...] = (), to_exceed: float = -math.inf
    ) -> RemainderFit:
        effects = f.hypothesis.effects
        if copied:
            self.copied.append((effects, copied))
            return beside(f, self.copies.get(effects, 0.0), seen)
        self.refitted.append(effects)
        self.to_exceed[effects] = to_exceed
        return beside(f, self.adds.get(frozenset(effects), 0.0), seen)

    def add_beside_remainder(
        self, rest: RemainderFit, f: Any, seen: Any, take: Any, to_exceed: float = -math.inf
    ) -> RemainderFit:
        effects = f.hypothesis.effects
        self.tried_from_rest.append(effects)
        nats = self.from_rest.get(effects, f.penalised_log_likelihood)
        return beside(f, nats - f.penalised_log_likelihood, seen)


def weights_of(**more: Any) -> NameWeights:
    return NameWeights(NOTHING, NOTHING, TrialChanges(NOTHING, []), (), (), chance(), **more)


def chance(gate: float = GATE) -> NullGains:
    return NullGains(gate, [CandidateEffect("rear_toe", [0.0], 3.0)])


def trials(*names: str) -> TrialChanges:
    return TrialChanges(NOTHING, [Trial(name, [], slice(0)) for name in names])
