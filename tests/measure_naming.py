"""`python tests/measure_naming.py SEED K/N TIERS MOST OUT`: what is named on blind cases, a row of JSON each.

TIERS are separated by commas, of each MOST cases are drawn; process K of N takes every N-th; rows are added to OUT.
"""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from bcid.diagnosis.diagnose import fit_base_model
from bcid.diagnosis.search.name_search import name_effects
from bcid.diagnosis.search.refits import fitted_corrections
from bcid.estimate.run import estimate_motion
from bcid.proof.blind.blind_case import BlindCase
from bcid.proof.blind.cases import draw_suite
from bcid.virtual_lab import TUNING, record_drive, simulated_vehicle


def name_case(case: BlindCase) -> dict[str, Any]:
    """What the search names on the take of a `case`, and the CPU time (s) of the base model's fit and of the search."""
    vehicle = simulated_vehicle()
    recording = record_drive(case.simulate(), case.rate_hz, vehicle)
    estimate, began = estimate_motion(recording, vehicle, TUNING), time.process_time()
    with threadpool_limits(1, "blas"):
        base = fit_base_model([recording], [estimate], vehicle)
        fitted = time.process_time()
        naming = name_effects(base.fit, base.take, case.left_out)
    return {
        "names": {name: round(nats, 1) for name, nats in naming.gains.items()},
        "dropped": {name: round(nats, 1) for name, nats in naming.dropped.items()},
        "gate": round(naming.nulls.gate, 1), "before": round(naming.before.nats, 1), "rest": round(naming.rest.nats, 1),
        "channels": {channel: round(nats, 1) for channel, nats in naming.rest.seen.channel_nats().items()},
        "corrections": list(fitted_corrections(naming.best)),
        "base_s": round(fitted - began, 1), "naming_s": round(time.process_time() - fitted, 1),
    }  # fmt: skip


def main(seed: int, share: str, tiers: str, most: int, out: Path) -> None:
    """Name what this process's share of the cases conceals, and add a row of each to `out`."""
    mine, processes = map(int, share.split("/"))
    suite, rng = list(draw_suite(seed, 1, 6, 6, 12)), np.random.default_rng(seed)
    chosen = list[Any]()
    for tier in tiers.split(","):
        cases = [c for c in suite if c.tier == tier]
        chosen += [cases[i] for i in rng.permutation(len(cases))[:most]]
    for case in chosen[mine::processes]:
        row = {"seed": seed, "case": case.name, "tier": case.tier, "answer": case.answer, "channel": case.channel}
        try:
            row |= name_case(case)
        except Exception as error:  # a case that fails is a row, too
            row["error"] = repr(error)[:300]
        with out.open("a", encoding="utf-8") as file:
            file.write(json.dumps(row) + "\n")


if __name__ == "__main__":
    main(int(sys.argv[1]), *sys.argv[2:4], int(sys.argv[4]), Path(sys.argv[5]))
