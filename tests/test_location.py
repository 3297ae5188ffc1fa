"""Where a mismatch is before any hypothesis: channel and dependence of free functions, regime, place and time."""

from __future__ import annotations

import numpy as np
import pytest
from test_naming import BUMPER_CAR, driven

from bcid.aliases import Floats
from bcid.diagnosis.limits import LOCATE_LIMITS
from bcid.diagnosis.locate.mismatch import Location, describe_regime, locate_mismatch
from bcid.diagnosis.locate.pushes import Disturbances
from bcid.diagnosis.remainder.evidence import Quadratic
from bcid.diagnosis.remainder.explain import Explained
from bcid.diagnosis.remainder.functions import RemainderBasis
from bcid.effects.remainder_table import COLUMNS, INPUTS, WAVE
from bcid.likelihood.tracking_functions import TRACKING_COLUMNS


def explaining(**channels: tuple[float, str]) -> Explained:
    """Functions of which each channel has one, that depends on one quantity and explains so many nats."""
    functions = np.zeros((len(channels), COLUMNS))
    for k, (_, name) in enumerate(channels.values()):
        functions[k, WAVE + INPUTS.index(name)] = 1.0
    basis = RemainderBasis(functions, np.zeros((0, TRACKING_COLUMNS)), tuple(channels), np.ones(len(channels)))
    spread = {name: 3.0 if nats else 0.0 for name, (nats, _) in channels.items()}
    G = 100.0
    b = np.array([np.sqrt(2.0 * G * nats) for nats, _ in channels.values()])
    quadratic = Quadratic(b, G * np.eye(len(channels)))
    return Explained((), basis, spread, quadratic, quadratic.posterior_mean(basis.sd(spread)), np.zeros(0), np.ones(3))


def located(seen: Explained, of: Disturbances) -> Location:
    """Where such disturbances are, beside what free functions explain."""
    return locate_mismatch(seen.channel_nats(), seen.depends_on, of, BUMPER_CAR)


def louder(of: Disturbances, inside: Floats, component: int | slice, times: float = 3.0) -> Disturbances:
    """The disturbances with those in one component, where `inside`, so many times as strong."""
    strength = of.strength.copy()
    strength[:, component] = (
        np.where(inside[:, None] if strength[:, component].ndim > 1 else inside, times, 1.0) * (strength[:, component])
    )
    return of._replace(strength=strength)


def turning(seed: int = 0) -> Disturbances:
    """Disturbances of nothing, of a drive that speeds up, slows down and turns both ways."""
    of, rng = driven(seed), np.random.default_rng(seed)
    K = len(of.time_s)
    smooth = {name: np.convolve(rng.standard_normal(K), np.ones(12) / np.sqrt(12.0), "same") for name in
              ("v_x", "omega", "delta", "delta_rate", "u_m", "alpha_f")}  # fmt: skip
    smooth["v_x"] = np.abs(smooth["v_x"])
    return of._replace(states=of.states | smooth)


def test_the_channel_is_where_free_functions_explain_most() -> None:
    seen = explaining(fx=(30.0, "v_x"), motor=(80.0, "u_m"), fy=(0.0, "alpha_f"))
    found = located(seen, turning())
    assert found.channel == "motor"
    assert found.depends_on == ("throttle",)
    assert list(found.channel_nats) == ["motor", "fx"]
    assert found.channel_nats["motor"] == pytest.approx(80.0, abs=5.0)


def test_where_free_functions_explain_nothing_there_is_no_channel() -> None:
    found = located(explaining(fx=(0.0, "v_x"), mz=(0.0, "omega")), turning(1))
    assert (found.channel, dict(found.channel_nats), found.depends_on) == (None, {}, ())
    assert found.regime == "throughout"


@pytest.mark.parametrize("seed", [0, 1])
def test_place_and_time_are_told_where_they_are_significant_only(seed: int) -> None:
    of, seen = driven(seed), explaining(fx=(50.0, "v_x"))
    nothing = located(seen, of)
    assert nothing.place is None or nothing.place_p_value < LOCATE_LIMITS.significant_p_value
    assert (nothing.place is None) is (nothing.place_p_value >= LOCATE_LIMITS.significant_p_value)
    assert (nothing.window is None) is (nothing.window_p_value >= LOCATE_LIMITS.significant_p_value)
    inside = np.hypot(of.states["p_x"] - 4.0, of.states["p_y"] - 2.5) < 1.0
    here = located(seen, louder(of, inside, slice(0, 3)))
    assert here.place is not None
    assert np.hypot(here.place.x - 4.0, here.place.y - 2.5) < 0.5
    late = located(seen, louder(of, of.time_s > 90.0, slice(0, 3)))
    assert late.window is not None
    assert late.window.begin_s == pytest.approx(90.0, abs=6.0)


@pytest.mark.parametrize(
    ("channel", "component", "seen_there"),
    [
        ("fx", 0, True), ("motor", 0, True), ("fy", 1, True), ("fy", 2, True), ("fy", 0, False),
        ("steering", 2, True), ("mz", 2, True), ("mz", 0, False), ("fx", 2, False), ("pose", 1, True),
    ],
)  # fmt: skip
def test_the_regime_is_that_of_pushes_in_the_channel_s_components(
    channel: str, component: int, seen_there: bool
) -> None:
    """What acts along the car does not shake it about; what the tracking does may be any."""
    of = turning()
    braking = of.states["u_m"] < 0.0
    found = located(explaining(**{channel: (50.0, "u_m")}), louder(of, braking, component, 6.0))
    assert ("braking" in found.regime) is seen_there


def test_regimes_are_named_by_where_energy_is() -> None:
    of = turning(2)
    m, quiet = of.states, np.ones(len(of.time_s))
    assert describe_regime(of, quiet) == "throughout"
    left = m["omega"] > np.quantile(np.abs(m["omega"]), 1.0 - LOCATE_LIMITS.regime_quantile)
    assert describe_regime(of, np.where(left, 4.0, 0.1)).startswith("turning left")
    right = m["omega"] < -np.quantile(np.abs(m["omega"]), 1.0 - LOCATE_LIMITS.regime_quantile)
    assert describe_regime(of, np.where(right, 4.0, 0.1)).startswith("turning right")
    fast = m["v_x"] > np.quantile(np.abs(m["v_x"]), LOCATE_LIMITS.regime_quantile)
    assert describe_regime(of, np.where(fast, 4.0, 0.1)).startswith("fast, above ")
    every = describe_regime(of, np.where(fast & left, 50.0, 0.1))
    assert len(every.split(" and ")) <= LOCATE_LIMITS.max_regimes
