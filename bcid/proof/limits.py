"""Limits of the proof's scores: the goals of each tier, and what counts as right, as found and as chance.

No module that makes rows imports this one, so that rows outlive a change of it; the limits that take part in making
rows stand in `bcid/proof/blind/limits.py` and `bcid/proof/real/limits.py`.
"""

from dataclasses import dataclass

GOALS: dict[str, dict[str, tuple[float, float]]] = {
    "single": {"right": (0.95, 1.0), "top1": (0.98, 1.0), "set": (0.98, 1.0), "set_size": (0.0, 1.6),
               "parameter_error": (0.0, 0.03), "coverage": (0.88, 0.98), "oracle_share": (0.95, 2.0),
               "kind": (0.95, 1.0), "seconds": (0.0, 8.0), "unshown": (0.0, 0.05), "denied": (0.0, 0.05)},
    "single-imperfect": {"right": (0.9, 1.0), "top1": (0.96, 1.0), "set": (0.96, 1.0), "coverage": (0.88, 0.98),
                         "kind": (0.95, 1.0), "unshown": (0.0, 0.05), "denied": (0.0, 0.05)},
    "null": {"false": (0.0, 0.01), "seconds": (0.0, 8.0)},
    "null-imperfect": {"false": (0.0, 0.01)},
    "left-out": {"right": (0.8, 1.0), "unknown": (0.9, 1.0), "channel": (0.8, 1.0), "wrong": (0.0, 0.05)},
    "pair": {"right": (0.9, 1.0), "exact": (0.95, 1.0)},
    "triple": {"right": (0.9, 1.0), "exact": (0.9, 1.0)},
    "outside": {"right": (0.8, 1.0), "unknown": (0.9, 1.0), "channel": (0.8, 1.0), "wrong": (0.0, 0.05)},
    "unexcited": {"right": (0.8, 1.0), "not_seen": (0.8, 1.0), "wrong": (0.0, 0.1)},
    "closed-loop": {"right": (0.9, 1.0), "top1": (0.9, 1.0), "wrong": (0.0, 0.1)},
    "small-exact": {"right": (0.9, 1.0), "top1": (0.95, 1.0), "wrong": (0.0, 0.05)},
    "small-plus": {"right": (0.9, 1.0), "top1": (0.95, 1.0), "wrong": (0.0, 0.05)},
    "small-null": {"false": (0.0, 0.02)},
    "small-wrong": {"right": (0.75, 1.0), "set": (0.85, 1.0), "wrong": (0.0, 0.1)},
    "small-outside": {"right": (0.8, 1.0), "unknown": (0.9, 1.0), "channel": (0.8, 1.0), "wrong": (0.0, 0.05)},
    "other-laws": {"false": (0.0, 0.1)},
    "other-laws-less": {"right": (0.85, 1.0), "top1": (0.85, 1.0), "wrong": (0.0, 0.1)},
    "other-day": {"false": (0.0, 0.1)},
    "other-day-less": {"right": (0.85, 1.0), "top1": (0.85, 1.0), "wrong": (0.0, 0.1)},
    "tricycle": {"right": (0.9, 1.0), "wrong": (0.0, 0.1)},
    **{tier: {"right": (0.92, 1.0), "wrong": (0.0, 0.1)} for tier in (
        "two-minutes", "ten-hertz", "three-times-noise", "half-size",
    )},
    **{tier: {"right": (0.9, 1.0), "wrong": (0.0, 0.1)} for tier in (
        "double-size", "measurement-and-vehicle", "thirty-minutes", "hundred-twenty-hertz",
    )},
}  # fmt: skip
"""Lowest and highest value that the project wants of each score (a field of `TierScores`), by tier.

A table, not a dataclass: tiers and scores are names in prove.json, and most tiers have few goals.  The ranges hold
shares of takes, but for `set_size` (names), `parameter_error` (relative) and `seconds`.  These are aims, not derived
from data; docs/results/prove.json says which are missed.
"""

REAL_GOALS: dict[str, tuple[float, float]] = {
    "withheld: questions with an answer": (20.0, float("inf")),
    "withheld: right": (0.9, 1.0),
    "withheld: named first": (0.75, 1.0),
    "withheld: false names a question": (0.0, 0.3),
    "controls: right": (1.0, 1.0),
    "controls: false names a question": (0.0, 0.0),
    "edits: found, with their size": (0.9, 1.0),
    "replication: same names and sizes": (0.8, 1.0),
    "transfer: augmented below base": (0.9, 1.0),
    "transfer: augmented best of all": (0.8, 1.0),
    "another start: other answer": (0.0, 0.1),
    "CPU seconds a minute of drive, median": (0.0, 60.0),
}
"""Lowest and highest wanted value of each figure of real recordings (`bcid.proof.real.figures`): issue 42, before any
answer to these questions had been seen.
"""


@dataclass(frozen=True)
class ScoreLimits:
    """What counts as a right answer, as an edit found again, as chance, and as a verdict that hangs on a limit."""

    # Names (an effect and its twins) that an answer may hold for one effect; a longer set tells too little.  A
    # diagnosis reports three twins at most; docs/results/prove.json has 1.02 names on average.
    max_names_per_effect: int = 4
    # Probability of as few right answers, were all goals just met, below which a short run misses its goals.
    # docs/results/prove_quick.json would fail with 13 or fewer of its 20 takes right.
    refuting_p: float = 0.01
    # Level at which p-values of takes of nothing are counted; their share should equal it.  docs/results/prove.json has
    # 0.037, 95 % interval 0.018 to 0.065, of 300 takes.
    null_p_level: float = 0.05
    # Share of verdicts that may change where a limit is halved or doubled.  An aim, not derived from data.
    max_changed_share: float = 0.02
    # Errors of a parameter within which an edit counts as found, as a share of its size.  Not yet justified;
    # docs/results/real_dart.json has 2 to 44 %.
    edit_error_share: float = 0.25
    # Standard errors within which an edit counts as found, where these are larger.  Not yet justified.
    edit_error_se: float = 3.0
    # Share of an edit's size that standard errors may reach at most.  Not yet justified.
    max_edit_error_share: float = 0.5


LIMITS = ScoreLimits()
