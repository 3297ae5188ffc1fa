"""The missing law before any hypothesis: a curve with a band, and the named law over it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest

from bcid.diagnosis.diagnose import diagnose_recordings, fit_base_model
from bcid.diagnosis.limits import SUMMARY_LIMITS
from bcid.diagnosis.remainder.curve import MissingLaw, _merged_bins, change_by_names, missing_laws
from bcid.diagnosis.remainder.explain import Explained, basis_for, explain, explain_with_copies
from bcid.diagnosis.remainder.information import gather_information
from bcid.diagnosis.summary import summarise_diagnosis
from bcid.effects.table import EFFECTS
from bcid.estimate.run import estimate_motion
from bcid.likelihood.refit import Fit, refit
from bcid.likelihood.take import Take
from bcid.recording.types import Recording
from bcid.simulation.car import Plant, Sensor
from bcid.simulation.drive import simulate_drive
from bcid.virtual_lab import TUNING, record_drive, simulated_vehicle

DRAG = 25.0  # N s/m
GATE = 12.0


class Seen(NamedTuple):
    """What free functions explain of a simulated take beside the base model."""

    fit: Fit
    take: Take
    explained: Explained

    def laws(self, change: np.ndarray | None = None) -> dict[str, MissingLaw]:
        """The laws of the channels that stand out."""
        channels = [c for c, nats in self.explained.channel_nats().items() if nats > GATE]
        return missing_laws(self.fit, self.take, self.explained, channels, change)

    def change_by(self, name: str, size: float) -> np.ndarray:
        """The change of predicted poses by a named effect, refitted."""
        h, phi = self.fit.hypothesis.add_effect(name, self.fit.phi, [size])
        change = change_by_names(self.fit, refit(self.take, h, phi, self.fit.start, self.fit.scales), self.take)
        assert change is not None
        return change


def recorded(seconds: float, **plant: float) -> Recording:
    return record_drive(simulate_drive(Plant(**plant), Sensor(), seconds, 4), 60.0, simulated_vehicle())


def seen_of(seconds: float, **plant: float) -> Seen:
    vehicle, recording = simulated_vehicle(), recorded(seconds, **plant)
    base = fit_base_model([recording], [estimate_motion(recording, vehicle, TUNING)], vehicle)
    fit, take = base.fit, base.take
    return Seen(fit, take, explain_with_copies(fit, take, explain(fit, take, basis_for(fit, take)).basis))


@pytest.fixture(scope="module")
def drag() -> Seen:
    return seen_of(150.0, rear_rolling_viscous=DRAG)


def test_a_drag_is_seen_over_the_speed_within_its_band(drag: Seen) -> None:
    """a_x = -b v / m: what the refitted base model may have taken up is in the band, too."""
    law = drag.laws()["fx"]
    assert law.quantity == "v_x"
    assert law.named is None
    assert len(law.x) > 15
    assert np.ptp(law.x) > 1.0
    truth = -DRAG * law.x / drag.fit.car().m
    assert np.mean(np.abs(law.y - truth) < 2.0 * law.sd) > 0.9
    # the band says something: zero lies outside where the car is fast
    fast = law.x > 0.7 * law.x.max()
    assert (law.y[fast] < 0.0).all()
    assert np.abs(law.y / law.sd).max() > 4.0


def test_the_right_name_lies_in_the_band_and_a_wrong_one_does_not(drag: Seen) -> None:
    right = drag.laws(drag.change_by("rear_rolling_viscous", DRAG))["fx"]
    assert right.named is not None
    off = np.abs(right.named - right.y) / right.sd
    assert np.mean(off < 2.0) > 0.9
    wrong = drag.laws(drag.change_by("yaw_scrub", 5.0))["fx"]
    assert wrong.named is not None
    np.testing.assert_array_equal(wrong.y, right.y)
    assert np.abs((wrong.named - wrong.y) / wrong.sd).max() > 4.0


def test_the_residual_in_its_own_place_changes_nothing(drag: Seen) -> None:
    """What names would have shown is linear in the change of poses, and of the actual residual what the take shows."""
    basis = drag.explained.basis
    at = gather_information(drag.fit, drag.take, basis, np.zeros(len(basis.size)))
    own, weights = at.rows[:, :, -1], drag.explained.weights
    again, twice = (at.with_residual(size * own).weigh(weights).quadratic for size in (1.0, 2.0))
    expected = at._replace(phi=at.prior.centre).weigh(weights).quadratic
    np.testing.assert_allclose(again.b, expected.b, rtol=1e-6, atol=1e-6 * np.abs(expected.b).max())
    np.testing.assert_allclose(twice.b, 2.0 * again.b, rtol=1e-6, atol=1e-6 * np.abs(expected.b).max())
    np.testing.assert_array_equal(again.G, expected.G)


def test_no_names_change_nothing(drag: Seen) -> None:
    assert change_by_names(drag.fit, drag.fit, drag.take) is None


def test_nothing_has_no_curve() -> None:
    assert seen_of(120.0).laws() == {}


def test_a_sway_of_the_floor_is_one_wave_within_its_period() -> None:
    """A wave of the floor turns with the car's heading: it is told along the floor, over one period."""
    law = seen_of(120.0, floor_sway=30.0).laws()["fx"]
    assert law.quantity == "time"
    assert law.direction in ("world_x", "world_y")
    assert law.period_s is not None
    assert 0.0 < law.x.min() < law.x.max() < law.period_s
    sine, cosine = (f(2.0 * np.pi * law.x / law.period_s) for f in (np.sin, np.cos))
    left = law.y - np.column_stack([sine, cosine]) @ np.linalg.lstsq(np.column_stack([sine, cosine]), law.y)[0]
    assert np.abs(left).max() < 0.05 * np.ptp(law.y)
    assert np.ptp(law.y) > 10.0 * law.sd.max()


def test_curves_are_joined_where_little_was_driven() -> None:
    q = np.r_[np.linspace(0.0, 1.0, 400), np.linspace(1.0, 10.0, 30)]
    place = _merged_bins(q, 0.0, 10.0)
    assert np.bincount(place).min() >= SUMMARY_LIMITS.min_knots_per_bin
    assert (np.diff(place) >= 0).all()
    assert len(np.bincount(place)) >= 4
    np.testing.assert_array_equal(_merged_bins(np.zeros(5), 0.0, 0.0), 0)


@pytest.mark.parametrize("left_out", [(), tuple(n for n in EFFECTS if n != "tether_pull")], ids=["named", "left out"])
def test_a_diagnosis_holds_the_law_and_a_named_one_only_where_there_are_names(left_out: tuple[str, ...]) -> None:
    recording = recorded(120.0, yaw_scrub=20.0)
    vehicle = simulated_vehicle()
    estimates = [estimate_motion(recording, vehicle, TUNING)]
    written = summarise_diagnosis(diagnose_recordings([recording], estimates, vehicle, excluded=left_out))
    first = written.remainder[0]
    assert written.kind == "bcid.diagnosis/2"
    assert (first.channel, first.nats_before > GATE) == ("mz", True)
    assert first.curve is not None
    assert (first.curve.quantity, first.curve.unit, first.curve.y_unit) == ("yaw_rate", "rad/s", "rad/s^2")
    y, sd = np.array(first.curve.y), np.array(first.curve.sd)
    if left_out:
        assert written.findings == ()
        assert first.curve.named is None
        assert first.nats_left > GATE
    else:
        assert [f.effect for f in written.findings] == ["yaw_scrub"]
        assert np.mean(np.abs(np.array(first.curve.named) - y) < 2.0 * sd) > 0.9
        assert first.nats_left < GATE
    assert all(r.curve is None for r in written.remainder if r.nats_before < 1.0)
