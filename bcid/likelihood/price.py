"""What a parameter costs: the same in a search, in a verdict, in what a drive does not show, and in a plan."""

import math


def price_nats(parameters: int, segments: int) -> float:
    """Nats that so many `parameters` of effects cost in a take of so many `segments`: k/2 ln(S), as in BIC."""
    return 0.5 * parameters * math.log(max(segments, 1))
