"""`python tests/measure_size.py EFFECT SEEDS SIZES`: at which sizes ten minutes of the bumper car show an effect.

For each seed and size the base model is refitted to a simulated drive that has the effect, and predicts blocks that
the refit has not seen for 2 s at a time.  Its error (root mean square of the twist) over that on the same drive without
the effect, which is the noise floor, is written to docs/results/size_EFFECT.json.  SEEDS and SIZES are separated by
commas.  The vocabulary's sizes are those at which the ratio is 1.3 to 4.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from bcid.diagnosis.diagnose import fit_base_model
from bcid.diagnosis.judge.prediction_error import compare_predictions
from bcid.estimate.run import estimate_motion
from bcid.proof.blind.blind_case import BlindCase
from bcid.proof.blind.concealed_effects import ConcealedEffect
from bcid.virtual_lab import TUNING, record_drive, simulated_vehicle

RESULTS = Path(__file__).parents[1] / "docs" / "results"
HORIZON_S = 2.0
RATIOS = (1.3, 4.0)


def held_out_error(constant: str, size: float, seed: int) -> float:
    """Normalised error (root mean square) of the refitted base model's 2 s predictions on blocks not seen.

    The simulated drive is that of the `seed`, of a car whose `constant` is `size` (SI).
    """
    case = BlindCase("size", 0, (ConcealedEffect("size", plant={constant: size}),), seed=seed)
    vehicle = simulated_vehicle()
    recording = record_drive(case.simulate(), case.rate_hz, vehicle)
    estimate = estimate_motion(recording, vehicle, TUNING)
    with threadpool_limits(1, "blas"):
        base = fit_base_model([recording], [estimate], vehicle)
        rows = compare_predictions(base.fit, base.fit, base.take, recording, estimate, vehicle, TUNING).horizons
    (nmse,) = (row.nmse_before for row in rows if row.horizon_s == HORIZON_S)
    assert nmse is not None
    return float(np.sqrt(nmse))


def sizes_at_ratios(rows: list[dict[str, float]]) -> list[float]:
    """Sizes at which the ratio of errors, as the geometric mean over seeds, passes each of RATIOS.

    Between the sizes of `rows` the logarithm of the ratio is a line over that of the size.
    """
    sizes = sorted({row["size"] for row in rows})
    means = [np.mean([np.log(row["ratio"]) for row in rows if row["size"] == size]) for size in sizes]
    return [float(np.exp(np.interp(np.log(ratio), means, np.log(sizes)))) for ratio in RATIOS]


def main(effect: str, seeds: list[int], sizes: list[float]) -> None:
    """Measure the ratios of an effect whose constant of the simulation has its name, and write them."""
    rows = list[dict[str, float]]()
    for seed in seeds:
        floor = held_out_error(effect, 0.0, seed)
        for size in sizes:
            rows.append({"seed": seed, "size": size, "ratio": round(held_out_error(effect, size, seed) / floor, 3)})
    low, high = sizes_at_ratios(rows)
    told = {"effect": effect, "sizes": [round(low, 1), round(high, 1)], "rows": rows}
    (RESULTS / f"size_{effect}.json").write_text(json.dumps(told, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1], [int(s) for s in sys.argv[2].split(",")], [float(s) for s in sys.argv[3].split(",")])
