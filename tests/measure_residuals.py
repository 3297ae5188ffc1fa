"""How large a model's residuals are where it lacks nothing, and where it does: figures for bcid/evaluation/limits.py.

`python tests/measure_residuals.py FOLDER` simulates drives of the paper's car and of the bumper car with all its
extras, fits newton-euler to each by each loss, and prints the ratio of residuals.json, over what it usually is.  A
quarter of an hour on two cores; what lies in FOLDER already is reused.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from bcid.evaluation.residuals import load_residuals
from bcid.models.settings import LOSSES, CarLoss
from bcid.pipeline.config import PipelineConfig
from bcid.pipeline.run import Pipeline
from bcid.simulation.car import configure_simulation
from bcid.simulation.samples import VEHICLE, SampleTake, write_sample_take


class SimulatedDrive(NamedTuple):
    """A drive to measure the residuals of."""

    ideal: bool  # the paper's car, which lacks nothing
    seed: int
    seconds: float = 120.0
    rate_hz: float = 60.0
    noise: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        """The drive in words that make a folder's name."""
        car = "paper's car" if self.ideal else "real car"
        return " ".join([car, f"{self.seed}", f"{self.seconds:g} s", f"{self.rate_hz:g} Hz", *self.noise])


COARSE, FINE = ("position_noise=0.005",), ("position_noise=0.0001", "yaw_noise=0.0003")


def drives() -> Iterator[SimulatedDrive]:
    """Drives of both cars, then with other noise, rates and lengths."""
    for ideal in (True, False):
        yield from (SimulatedDrive(ideal, seed) for seed in range(1, 5))
        yield from (SimulatedDrive(ideal, 11, noise=noise) for noise in (COARSE, FINE))
    yield from (SimulatedDrive(True, 11, rate_hz=rate) for rate in (20.0, 200.0))
    yield from (SimulatedDrive(True, 11, seconds=seconds) for seconds in (40.0, 400.0))


def fit_and_measure(drive: SimulatedDrive, loss: CarLoss, folder: Path) -> float:
    """The residuals' multiple of the usual, of newton-euler fitted by a `loss` to a drive that is simulated first."""
    home = folder / drive.name
    take, car = home / "t.mcap", home / "car.toml"
    if not take.exists():
        home.mkdir(parents=True)
        car.write_text(VEHICLE, encoding="utf-8")
        plant, sensor = configure_simulation(drive.ideal, drive.noise, drive.rate_hz)
        write_sample_take(home, SampleTake("t", "mcap", drive.seconds), plant, sensor, drive.seed)
    config = PipelineConfig(source="measure_residuals", vehicle=car, training=[take])
    config = config.model_copy(update={"workspace": home / "workspace"}).with_loss(loss)
    residuals = load_residuals(Pipeline(config).fit("newton-euler").folder)
    assert residuals is not None
    return residuals.multiple


def main(folder: Path) -> None:
    """Print a line for each drive: its multiples by each loss."""
    for drive in drives():
        multiples = {loss: fit_and_measure(drive, loss, folder) for loss in LOSSES}
        figures = "  ".join(f"{loss} {multiple:.2f}" for loss, multiple in multiples.items())
        print(f"{drive.name:45} {figures}", flush=True)  # noqa: T201


if __name__ == "__main__":
    main(Path(sys.argv[1]))
