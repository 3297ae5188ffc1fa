"""How well a drive shows each effect, and which it could not have shown, unless unusually large for this vehicle."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from bcid.aliases import Floats
from bcid.diagnosis.limits import JUDGE_LIMITS
from bcid.documents.diagnosis import Detectable, NotExcited
from bcid.effects.entry import VehicleScale
from bcid.effects.table import EFFECTS
from bcid.experiment.detectability import (
    PlacedAmplitude,
    amplitudes_at_typical_places,
    expected_gains_nats,
    required_gain_nats,
    solve_smallest_sizes,
)
from bcid.likelihood.limits import LIKELIHOOD_LIMITS
from bcid.likelihood.refit import Fit
from bcid.likelihood.take import Take


class Excitation(NamedTuple):
    """How well a drive shows the effects that are not in a fit."""

    not_excited: tuple[NotExcited, ...]
    # by effect and parameter, the size at which one nat is expected; none of what has a place
    nat_sizes: Mapping[str, Mapping[str, float]]


def measure_excitation(fit: Fit, take: Take, units: VehicleScale, gate_of: Callable[[str], float]) -> Excitation:
    """How well this drive shows the effects that are not in `fit`, and which not even at a multiple of usual sizes.

    The multiple is `JUDGE_LIMITS.unexcited_sizes`.  An effect shows if, at the best of several places, it is expected
    to raise the log-likelihood by its gate (`gate_of` its name) and its price (`required_gain_nats`).  Each is listed
    with the smallest size that would have shown, None if no size would.  Usual sizes are declared with the effect for
    the bumper car and scaled by `units` to this vehicle at full speed, since an effect that matters at full speed may
    not show in a slow drive.
    """
    at_speed = replace(fit.hypothesis, units=units)
    names = [n for n in EFFECTS if n in at_speed.entries and n not in at_speed.effects]
    usual = amplitudes_at_typical_places(names, take, at_speed)
    placeless = [a for a in usual if not at_speed.entries[a.effect].place_parameters]
    amplitudes = [
        a.with_size(min(JUDGE_LIMITS.unexcited_sizes * a.values[a.parameter_index], a.parameter.high)) for a in usual
    ]
    required = np.array(
        [required_gain_nats(at_speed.entries[a.effect], take.segments, gate_of(a.effect)) for a in amplitudes]
    )
    gains, of_usual = np.split(expected_gains_nats(fit, take, [*amplitudes, *placeless]), [len(amplitudes)])
    best = dict[tuple[str, str], int]()
    for i, a in enumerate(amplitudes):
        key = (a.effect, a.parameter.symbol)
        best[key] = max(best.get(key, i), i, key=lambda j: gains[j])
    missed = [i for i in best.values() if gains[i] < required[i]]
    nat_sizes = _sizes_of_a_nat(placeless, of_usual)
    if not missed:
        return Excitation((), nat_sizes)
    rows, chosen = [], [amplitudes[i] for i in missed]
    for a, size in zip(chosen, solve_smallest_sizes(fit, take, chosen, required[missed]), strict=True):
        quoted = a.parameter.quote(size if np.isfinite(size) else 0.0, None)
        smallest = Detectable(value=quoted.value if np.isfinite(size) else None, unit=quoted.unit)
        rows.append(NotExcited(effect=a.effect, parameter=quoted.symbol, smallest_detectable=smallest))
    return Excitation(tuple(rows), nat_sizes)


def _sizes_of_a_nat(usual: Sequence[PlacedAmplitude], gains: Floats) -> dict[str, dict[str, float]]:
    """The sizes, by effect and parameter, at which one nat is expected, of those that are expected to gain `gains`.

    Gains of `usual` sizes are taken to grow with the square of a size: as they do near these, but for laws with a
    threshold, which far below it show nothing.
    """
    sizes = dict[str, dict[str, float]]()
    for a, gain in zip(usual, gains.tolist(), strict=True):
        if gain > LIKELIHOOD_LIMITS.min_information:
            sizes.setdefault(a.effect, {})[a.parameter.symbol] = abs(a.values[a.parameter_index]) / math.sqrt(gain)
    return sizes
