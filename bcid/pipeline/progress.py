"""Progress of a diagnosis as a share of its time: its rounds of search are counted, as nobody knows how many follow."""

import math

from bcid.aliases import Progress

# Shares that a diagnosis says of itself when a part of it begins, and the share of its time that has gone by then, of
# drives of one to five minutes.
SAID_SHARES = (0.0, 0.02, 0.05, 0.3, 0.8, 0.85, 0.92, 0.95, 1.0)
TIME_SHARES = (0.0, 0.01, 0.03, 0.12, 0.86, 0.89, 0.925, 0.99, 1.0)
SEARCH_SHARE = 0.3
"""The share that each round of the search for names says."""
TYPICAL_ROUNDS = 20.0
"""Rounds after which a share 1 - 1/e of the search's time is over, as a rule: the last, in which each name is left out,
takes the longest."""


def spread_rounds(progress: Progress) -> Progress:
    """What a diagnosis calls with its progress, so that `progress` gets shares of the time that grow from call to call.

    Each round of the search moves on by a part of what is left until the search ends, so that it may take as many
    as it likes.
    """
    rounds = 0

    def advance(share: float, text: str) -> None:
        nonlocal rounds
        done = _interpolate(share)
        if share == SEARCH_SHARE:
            end = _interpolate(SAID_SHARES[SAID_SHARES.index(SEARCH_SHARE) + 1])
            done += (end - done) * (1.0 - math.exp(-rounds / TYPICAL_ROUNDS))
            rounds += 1
        progress(done, text)

    return advance


def _interpolate(share: float) -> float:
    """The share of a diagnosis's time that has gone by when it says `share`."""
    share = min(max(share, 0.0), 1.0)
    upper = next(i for i, said in enumerate(SAID_SHARES) if said >= share)
    if upper == 0:
        return TIME_SHARES[0]
    low, high = SAID_SHARES[upper - 1], SAID_SHARES[upper]
    along = (share - low) / (high - low)
    return TIME_SHARES[upper - 1] + along * (TIME_SHARES[upper] - TIME_SHARES[upper - 1])
