"""What the diagnosis of one log says of effects, as a fleet takes it."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

from bcid.documents.diagnosis import DiagnosisDocument, NamedEffect
from bcid.effects.table import EFFECTS
from bcid.likelihood.price import price_nats


class Way(NamedTuple):
    """A way in which a log may have an effect: what it adds, what others would add there instead, and beside what."""

    nats: float
    instead: Mapping[str, float]  # by effect
    beside: frozenset[str]  # findings that stay


@dataclass(frozen=True)
class LogEvidence:
    """What the diagnosis of one log says of effects, in nats."""

    named: Mapping[str, float]  # that each finding adds
    others: Mapping[str, float]  # that each other effect would add beside the findings
    instead: Mapping[tuple[str, str], float]  # by a finding and another effect: that this adds in its place
    stretches: int = 1  # of the log, which say what a parameter of an effect costs
    unseen: frozenset[str] = frozenset()  # effects that the drive does not excite
    # by effect and parameter, the sizes that the log shows, and those that are expected to add a nat
    sizes: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    nat_sizes: Mapping[str, Mapping[str, float]] = field(default_factory=dict)

    @classmethod
    def of_diagnosis(cls, document: DiagnosisDocument) -> LogEvidence:
        """The evidence in a diagnosis.json; its rivals have one finding exchanged for another effect each."""
        named = _finite((f.effect, f.gain_nats) for f in document.findings)
        instead = dict[tuple[str, str], float]()
        for rival in document.rivals:
            out, into = set(named) - set(rival.effects), set(rival.effects) - set(named)
            if len(out) == len(into) == 1:
                (finding,), (other,) = out, into
                instead |= {(finding, other): named[finding] - rival.behind_nats}
        unseen = frozenset(each.effect for each in document.not_excited)
        sizes = {f.effect: _sizes_of(f) for f in document.findings}
        others, nat_sizes = _finite(document.others_nats.items()), document.nat_sizes
        return cls(named, others, instead, document.stretches or 1, unseen, sizes, nat_sizes)

    @cached_property
    def effects(self) -> set[str]:
        """The effects of which the log says something: those that it names, and those that its drive excites."""
        said = {*self.others, *(other for _, other in self.instead)}
        return {*self.named, *(said - self.unseen)}

    def beside(self, effect: str) -> float:
        """Nats that an effect adds to the log with all other findings; -inf where the log does not say."""
        return self.named.get(effect, self.others.get(effect, -math.inf))

    def in_place(self, effect: str) -> dict[str, float]:
        """Nats that an effect adds in the place of a finding, by that."""
        return {finding: nats for (finding, other), nats in self.instead.items() if other == effect}

    def best(self, effect: str) -> float:
        """Nats that an effect adds at most, beside the findings or in the place of one."""
        return max((self.beside(effect), *self.in_place(effect).values()))

    def ways(self, effect: str) -> list[Way]:
        """How the log may have an effect: as a finding or beside all of them, or in the place of one."""
        if effect in self.named:
            return [self._way_in_place_of(effect, effect, self.named[effect])]
        others = sorted(self.effects - {effect, *self.named})
        ways = [Way(self.beside(effect), {o: self.beside(o) for o in others}, frozenset(self.named))]
        return ways + [self._way_in_place_of(f, effect, nats) for f, nats in self.in_place(effect).items()]

    def _way_in_place_of(self, finding: str, effect: str, nats: float) -> Way:
        """That the log has an effect, which adds `nats`, where a finding is left out, or is that effect."""
        instead = {other: x for (out, other), x in sorted(self.instead.items()) if out == finding}
        instead |= {finding: self.named[finding]}
        instead.pop(effect, None)
        return Way(nats, instead, frozenset(set(self.named) - {finding}))

    def at_size(self, nats: float, effect: str, usual: Mapping[str, float]) -> float:
        """Nats of an effect at the `usual` sizes, by parameter, that it has in other logs; here it adds `nats`.

        Of a log-likelihood -(a - a_i)^2/(2 s^2) of the size a, z^2/2 = a_i^2/(2 s^2) is what the own size adds before
        its price, and G = a^2/(2 s^2) what the other logs' size would: (a/a_1)^2, as this drive is expected to show one
        nat of the size a_1.  So a short or gentle drive is not expected to say what a long and fast one does.  At that
        size, of either sign as likely, the log gains ln cosh(2 sqrt(G z^2/2)) - G; a size that is given has no price.
        Where the drive does not say a_1, as of what has a place, it is `nats`.
        """
        nat_sizes = self.nat_sizes.get(effect, {})
        G = max(((size / nat_sizes[s]) ** 2 for s, size in usual.items() if nat_sizes.get(s, 0.0) > 0.0), default=0.0)
        own = max(nats + self.price(effect), 0.0)
        x = 2.0 * math.sqrt(G * own)
        return x + math.log1p(math.exp(-2.0 * x)) - math.log(2.0) - G if G > 0.0 else nats

    def price(self, effect: str) -> float:
        """Nats that the parameters of an effect cost."""
        parameters = len(EFFECTS[effect].parameters) if effect in EFFECTS else 1
        return price_nats(parameters, self.stretches)

    def are_alternatives(self, one: str, other: str) -> bool:
        """Whether the log shows one of two effects or the other, but does not say that it has both."""
        if one in self.named and other in self.named:
            return False
        neither = one not in self.named and other not in self.named
        return neither or (one, other) in self.instead or (other, one) in self.instead


def _sizes_of(finding: NamedEffect) -> dict[str, float]:
    """How large the parameters of a finding are, but for its place, as its law has them, not as they are quoted."""
    entry, sizes = EFFECTS.get(finding.effect), dict[str, float]()
    for p in entry.parameters if entry else ():
        quoted = finding.parameters.get(p.inverse_of or p.symbol)
        if not p.is_place and quoted and quoted.value:
            sizes[p.symbol] = abs(1.0 / quoted.value if p.inverse_of else quoted.value)
    return sizes


def _finite(pairs: Iterable[tuple[str, float | None]]) -> dict[str, float]:
    """Nats by effect, without those that are no number."""
    return {name: float(nats) for name, nats in pairs if nats is not None and math.isfinite(nats)}
