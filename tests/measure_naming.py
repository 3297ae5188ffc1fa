"""`python tests/measure_naming.py SEED K/N TIERS MOST OUT`: names by `bcid.diagnosis.naming` on blind cases, a row each.

TIERS are separated by commas, of each MOST cases are drawn; process K of N takes every N-th; rows are added to OUT.
"""

import json
import sys
import time

import numpy as np
from bcid.proof.blind.cases import draw_suite
from bcid.virtual_lab import TUNING, record_drive, simulated_vehicle
from bcid.estimate.run import estimate_motion
from bcid.diagnosis.diagnose import fit_base_model
from bcid.diagnosis.naming import name_effects
from threadpoolctl import threadpool_limits

seed = int(sys.argv[1])
k0, n = map(int, sys.argv[2].split("/"))
tiers = sys.argv[3].split(",")
most = int(sys.argv[4])
out = open(sys.argv[5], "a")
suite = list(draw_suite(seed, 1, 6, 6, 12))
rng = np.random.default_rng(seed)
chosen = []
for t in tiers:
    m = [c for c in suite if c.tier == t]
    idx = rng.permutation(len(m))[:most]
    chosen += [m[i] for i in idx]
for i, c in enumerate(chosen):
    if i % n != k0:
        continue
    v = simulated_vehicle()
    t0 = time.process_time()
    r = record_drive(c.simulate(), c.rate_hz, v)
    est = estimate_motion(r, v, TUNING)
    row = dict(seed=seed, case=c.name, tier=c.tier, answer=c.answer, channel=c.channel, imperfect=c.imperfect)
    t1 = time.process_time()
    try:
        with threadpool_limits(1, "blas"):
            b = fit_base_model([r], [est], v)
            t2 = time.process_time()
            nm = name_effects(b.fit, b.take, c.left_out)
        row |= dict(
            names={k: round(x, 1) for k, x in nm.gains.items()},
            plain={k: round(x, 1) for k, x in nm.plain_gains.items()},
            dropped=[(a, round(x, 1)) for a, x in nm.dropped],
            gate=round(nm.nulls.gate, 1),
            rest=round(nm.rest.nats, 1),
            worth={k: round(x, 1) for k, x in nm.rest.worth.items()},
            corr=[x for x in nm.corrected.hypothesis.effects],
            base_s=round(t2 - t1, 1),
            naming_s=round(time.process_time() - t2, 1),
        )
    except Exception as e:
        import traceback

        row["error"] = repr(e)[:300]
        traceback.print_exc()
    out.write(json.dumps(row) + "\n")
    out.flush()
