"""The missing law before any hypothesis: a curve with a band, and the named law over it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest

from bcid.diagnosis.diagnose import fit_base_model
from bcid.diagnosis.remainder.curve import MissingLaw, change_by_names, missing_laws
from bcid.diagnosis.remainder.fit import Explained, basis_for, explain
from bcid.estimate.run import estimate_motion
from bcid.likelihood.refit import Fit, refit
from bcid.likelihood.take import Take
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


def seen_of(seconds: float, **plant: float) -> Seen:
    vehicle = simulated_vehicle()
    recording = record_drive(simulate_drive(Plant(**plant), Sensor(), seconds, 4), 60.0, vehicle)
    fit, take = fit_base_model([recording], [estimate_motion(recording, vehicle, TUNING)], vehicle)[2::-2]
    return Seen(fit, take, explain(fit, take, basis_for(fit, take)))


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


def test_no_names_change_nothing(drag: Seen) -> None:
    assert change_by_names(drag.fit, drag.fit, drag.take) is None


def test_nothing_has_no_curve() -> None:
    assert seen_of(120.0).laws() == {}
