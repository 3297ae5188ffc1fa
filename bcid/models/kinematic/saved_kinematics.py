"""What the saved kinematic models have in common: the car's levers, steering and period."""

from typing import Any

from bcid.models.kinematic.state import KinematicCar
from bcid.models.saved_parts import Period, Positive, SavedPart, Switch


class SavedKinematicCar(SavedPart):
    """All constants of a `KinematicCar`."""

    l_f: Positive
    l_r: Positive
    T_s: Positive
    d: Positive
    period: Period
    follow: Switch = 1.0

    def to_car(self) -> KinematicCar:
        """The car with these constants."""
        return KinematicCar(**self.model_dump())


class SavedKMlp(SavedPart):
    """The JSON part of a saved K-MLP; its weights are arrays."""

    frame: SavedKinematicCar
    facts: dict[str, Any]
