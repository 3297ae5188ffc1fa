"""Proxies: effects that only stand in for something without a name, and leave much of it unexplained."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from bcid.diagnosis.limits import PROXY_LIMITS
from bcid.diagnosis.locate.channel_gains import channel_gains
from bcid.diagnosis.locate.mismatch import RemainingMismatch
from bcid.diagnosis.locate.pushes import estimate_disturbances, push_reduction_shares
from bcid.diagnosis.locate.scan_statistic import FloorCircle
from bcid.diagnosis.search.forward_backward import SearchResult
from bcid.diagnosis.search.line_search import phi_at_reference
from bcid.diagnosis.search.refits import gain_nats, named_effects
from bcid.effects.table import EFFECTS
from bcid.likelihood.divergence import none_if_diverged
from bcid.likelihood.refit import Fit, evaluate_fixed
from bcid.likelihood.take import Take

PUSH_DIRECTIONS = {"fx": ("along",), "motor": ("along",), "fy": ("across",), "mz": ("across",), "steering": ("across",)}
"""Where the pushes of what acts in a channel go; those of the other channels may go anywhere."""


class _Evidence(NamedTuple):
    """What a take shows with all named effects and without each: the evidence on which effects are proxies."""

    best: Fit
    leave_one_out: Mapping[str, Fit]
    unexplained: RemainingMismatch  # beside `best`

    @property
    def gains(self) -> dict[str, float]:
        """Nats that each named effect gains beside the others."""
        return {name: gain_nats(self.best, fit) for name, fit in self.leave_one_out.items()}

    def unexplained_channels(self, gate_nats: float) -> dict[str, float]:
        """Nats by channel that its basis functions would still gain, if these are beyond chance and not negligible."""
        least = max(gate_nats, PROXY_LIMITS.min_remainder_share * sum(self.gains.values()))
        return {channel: nats for channel, nats in self.unexplained.channel_gains.items() if nats > least}


def find_proxies(
    search: SearchResult, take: Take, place: FloorCircle | None, unexplained: RemainingMismatch
) -> tuple[str, ...]:
    """Ids of the named effects that are proxies: they only stand in for missing physics that has no name in the table.

    `place` is the circle on the floor where disturbances are largest, if any; `unexplained` what the best fit leaves.
    Where a reference model has a prior (it is trusted), an effect must be a proxy at that model's own parameters, too:
    a refit without the effect moves them, as far as their bounds, to explain what is missing, so that the effect seems
    to explain little.
    """
    if not named_effects(search.best):
        return ()
    evidence, gate = _Evidence(search.best, search.leave_one_out, unexplained), search.nulls.gate
    proxies = _select_proxies(evidence, take, place, gate)
    if not proxies or search.best.hypothesis.trusted_simulation is None:
        return proxies
    beside = none_if_diverged(
        lambda: _select_proxies(_evaluate_beside_reference(search, take, place), take, place, gate)
    )
    return proxies if beside is None else tuple(name for name in proxies if name in beside)


def _evaluate_beside_reference(search: SearchResult, take: Take, place: FloorCircle | None) -> _Evidence:
    """The evidence for proxies (effects that stand in for something unnamed), at a trusted reference's own parameters.

    The search's best fit, and its fits without one effect each, are evaluated at those parameters instead of
    refitted.  An effect without which predictions diverge is left out, so that it is no proxy: nothing else explains
    what it does.

    Raises:
        PredictionDiverged: predictions diverge with all effects as well.
    """
    best, without = _evaluate_at_reference(search.best, take), dict[str, Fit]()
    for name, fit in search.leave_one_out.items():
        less = none_if_diverged(_evaluate_at_reference, fit, take)
        if less:
            without[name] = less
    return _Evidence(best, without, RemainingMismatch.beside(best, take, place))


def _evaluate_at_reference(fit: Fit, take: Take) -> Fit:
    """The fit at a trusted reference model's own parameters instead of the refitted ones, other effects as fitted.

    Only initial states, disturbances and their standard deviations are estimated anew.
    """
    return evaluate_fixed(take, fit.hypothesis, phi_at_reference(fit), fit.scales)


def _select_proxies(evidence: _Evidence, take: Take, place: FloorCircle | None, gate_nats: float) -> tuple[str, ...]:
    """Ids of the effects that each stand in for something without a name; if none does, of those that do so jointly.

    An effect does so alone if, in some channel, basis functions (simple laws of the state) still gain more than
    `gate_nats` beside all effects, and `_is_proxy` holds.  Effects do so jointly (`_joint_proxies`) if extra-trees
    still predict the disturbances with a correlation and a gain (nats) beyond those of PROXY_LIMITS.
    """
    channels, regression = evidence.unexplained_channels(gate_nats), evidence.unexplained.regression
    alone = tuple(name for name in evidence.gains if channels and _is_proxy(name, evidence, take, place, channels))
    if alone or not regression.predictable or regression.correlation <= PROXY_LIMITS.min_correlation:
        return alone
    allowed = _allowed_remainder_share(take, PROXY_LIMITS.max_remainder_share) * sum(evidence.gains.values())
    return _joint_proxies(evidence, take) if regression.gain_nats > allowed else ()


def _is_proxy(
    name: str, evidence: _Evidence, take: Take, place: FloorCircle | None, channels: Mapping[str, float]
) -> bool:
    """Whether effect `name` only stands in for something else, without a name, that acts in one of the `channels`.

    `channels` holds the nats that basis functions (simple laws of the state) in a channel gain beside all effects.  In
    one channel three conditions must hold: these nats exceed a share of what the effect explains; without the effect
    the functions gain more, by another share of it; and the effect reduces disturbances in the channel's direction
    (`_relieves_channels`).  Both shares are in PROXY_LIMITS.  Some functions act only within the circle `place`.
    """
    without, gained = channel_gains(evidence.leave_one_out[name], take, place), evidence.gains[name]
    # to first order, as for the other channels, which is too little where the fit had to go far or where pushes do the
    # effect's work: then the gain of the refit counts
    own = without.get(EFFECTS[name].channel, max(without.values()))
    if take.pushed or gained > PROXY_LIMITS.first_order_factor * own:
        own = max(own, gained)
    allowed, overlap = (
        _allowed_remainder_share(take, PROXY_LIMITS.max_channel_share) * own,
        PROXY_LIMITS.min_overlap_share * own,
    )
    missing = [c for c, nats in channels.items() if nats > allowed and without[c] - nats > overlap]
    return _relieves_channels(missing, name, evidence, take)


def _allowed_remainder_share(take: Take, share: float) -> float:
    """Share of what effects explain (nats) that may stay unexplained before they count as proxies: `share` itself.

    For a take predicted under pushes (disturbances fitted to each 0.5 s) it is `PROXY_LIMITS.max_share_under_pushes`.
    """
    return PROXY_LIMITS.max_share_under_pushes if take.pushed else share


def _relieves_channels(channels: Sequence[str], name: str, evidence: _Evidence, take: Take) -> bool:
    """Whether effect `name` makes disturbances of the body smaller in the direction of one of the `channels`.

    Compared are squared disturbances of the fits without and with the effect.  Directions are along the body, or
    across and about it together; more than `PROXY_LIMITS.min_relief_share` of the decrease must be in the channel's.
    """
    if not channels:
        return False
    shares = push_reduction_shares(
        estimate_disturbances(evidence.leave_one_out[name], take), estimate_disturbances(evidence.best, take)
    )
    relief = (sum(shares[direction] for direction in PUSH_DIRECTIONS.get(c, tuple(shares))) for c in channels)
    return any(share > PROXY_LIMITS.min_relief_share for share in relief)


def _joint_proxies(evidence: _Evidence, take: Take) -> tuple[str, ...]:
    """Ids of the named effects that, together, stand in for something without a name; () if none.

    Each makes disturbances smaller in the direction of a channel in which extra-trees predict those that remain beside
    all effects, with a correlation above `PROXY_LIMITS.min_correlation`.
    """
    correlations = evidence.unexplained.regression.correlations
    channels = [c for c, r in correlations.items() if r > PROXY_LIMITS.min_correlation]
    return tuple(n for n in evidence.leave_one_out if _relieves_channels(channels, n, evidence, take))
