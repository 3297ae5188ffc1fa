"""What the diagnosis of one log says of effects and parameters, as a fleet takes it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from bcid.documents.diagnosis import DiagnosisDocument


class LogEvidence(NamedTuple):
    """What the diagnosis of one log says of effects, in nats."""

    named: Mapping[str, float]  # that each finding adds
    others: Mapping[str, float]  # that each other effect would add beside the findings
    instead: Mapping[tuple[str, str], float]  # by a finding and another effect: that this adds in its place

    @classmethod
    def of_diagnosis(cls, document: DiagnosisDocument) -> LogEvidence:
        """The evidence in a diagnosis.json; its rivals have one finding exchanged for another effect each."""
        named = {f.effect: float(f.gain_nats or 0.0) for f in document.findings}
        instead = dict[tuple[str, str], float]()
        for rival in document.rivals:
            out, into = set(named) - set(rival.effects), set(rival.effects) - set(named)
            if len(out) == len(into) == 1:
                (finding,), (other,) = out, into
                instead[finding, other] = named[finding] - rival.behind_nats
        return cls(named, document.others_nats, instead)

    def nats(self, effect: str) -> float | None:
        """What an effect adds, beside the findings or in the place of one; None where the log cannot say."""
        own = [table[effect] for table in (self.named, self.others) if effect in table]
        return max([*own, *(nats for (_, other), nats in self.instead.items() if other == effect)], default=None)

    def are_alternatives(self, one: str, other: str) -> bool:
        """Whether the log shows one of two effects or the other, but does not say that it has both."""
        if one in self.named and other in self.named:
            return False
        neither = one not in self.named and other not in self.named
        return neither or (one, other) in self.instead or (other, one) in self.instead
