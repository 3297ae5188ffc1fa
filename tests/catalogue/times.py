"""Rows 13 to 21 and 31 of the catalogue of bad input: clocks, stamps and gaps."""

from __future__ import annotations

import numpy as np

from catalogue.lab import NS0, Lab, Rows, Tries, stamp
from catalogue.rows import row


@row(13)
def _(lab: Lab) -> Tries:
    yield "mcap: 20 poses twice", lab.mcap([*lab.poses(), *lab.poses()[100:120]])
    yield (
        "motive: 20 rows twice",
        lab.motive(lambda rows: [*rows[:200], *[list(r) for r in rows[180:200]], *rows[200:]]),
    )


@row(14)
def _(lab: Lab) -> Tries:
    p = lab.P.copy()
    p[:, 0] += 0.01
    yield "mcap: 20 stamps twice, other value", lab.mcap([*lab.poses(), *lab.poses(p=p)[100:120]])
    c = lab.C.copy()
    c[:, 0] += 0.1
    yield "mcap: commands 20 stamps twice, other value", lab.mcap(None, [*lab.commands(), *lab.commands(c=c)[100:120]])


@row(15)
def _(lab: Lab) -> Tries:
    rows = lab.poses()
    rows[100], rows[101] = rows[101], rows[100]
    yield "mcap: two neighbours swapped", lab.mcap(rows, order=False)
    t = lab.T.copy()
    t[lab.T >= 15] -= 5.0 - 0.004
    yield "mcap: clock set back 5 s at 15 s (overlap)", lab.mcap(lab.poses(t))
    for back in (0.054, 0.304, 1.004):
        yield (
            f"mcap: both clocks set back {back:g} s at 15 s",
            lab.mcap(
                lab.poses(lab.T - back * (lab.T >= 15)), lab.commands(lab.TC - back * (lab.TC >= 15)), order=False
            ),
        )
    yield (
        "mcap: pose clock alone set back 0.104 s twice",
        lab.mcap(lab.poses(lab.T - 0.104 * ((lab.T >= 10).astype(int) + (lab.T >= 20))), order=False),
    )
    t2 = lab.TC.copy()
    t2[lab.TC >= 15] -= 5.0 - 0.004
    yield "mcap: both clocks set back 5 s at 15 s", lab.mcap(lab.poses(t), lab.commands(t2))
    yield "table: clock set back 5 s at 15 s", lab.table(lambda d: d.assign(t=d.t - 4.996 * (d.t >= 15))), lab.tabled
    yield "table: set back 20 s at 15 s (t < 0)", lab.table(lambda d: d.assign(t=d.t - 20 * (d.t >= 15))), lab.tabled
    yield (
        "motive: rows shuffled",
        lab.motive(
            lambda rows: [*rows[:7], *[rows[7:][i] for i in np.random.default_rng(0).permutation(len(rows) - 7)]]
        ),
    )


@row(16)
def _(lab: Lab) -> Tries:
    for jump in (0.2, 5.0, 700.0):
        t, t2 = lab.T + jump * (lab.T >= 15), lab.TC + jump * (lab.TC >= 15)
        yield f"mcap: both clocks jump {jump:g} s ahead", lab.mcap(lab.poses(t), lab.commands(t2))
    yield "mcap: pose clock alone jumps 0.2 s", lab.mcap(lab.poses(lab.T + 0.2 * (lab.T >= 15)))
    yield "mcap: pose clock alone jumps 5 s", lab.mcap(lab.poses(lab.T + 5.0 * (lab.T >= 15)))
    yield "mcap: command clock alone jumps 1 s", lab.mcap(None, lab.commands(lab.TC + 1.0 * (lab.TC >= 15)))


@row(17)
def _(lab: Lab) -> Tries:
    yield "mcap: commands 2000 ppm fast", lab.mcap(None, lab.commands(lab.TC * 1.002))
    yield "mcap: commands 50 ms early", lab.mcap(None, lab.commands(lab.TC - 0.05))


@row(18)
def _(lab: Lab) -> Tries:
    yield "motive: 30 rows left out", lab.motive(lambda rows: [*rows[:600], *rows[630:]])
    rng = np.random.default_rng(0)
    yield (
        "motive: 10 % of rows left out at random",
        lab.motive(lambda rows: [*rows[:7], *[r for r in rows[7:] if rng.random() > 0.1]]),
    )

    def renumbered(rows: Rows) -> Rows:
        del rows[600:630]
        for i, r in enumerate(rows[7:]):
            r[0], r[1] = str(i), f"{i / 60:.6f}"
        return rows

    yield "motive: 30 left out, frames renumbered", lab.motive(renumbered)
    yield "motive: Total Frames contradicts (header 1801)", lab.motive(lambda rows: rows[:1500])
    yield "mcap: 30 poses missing", lab.mcap([*lab.poses()[:600], *lab.poses()[630:]])


@row(19)
def _(lab: Lab) -> Tries:
    rows = lab.poses()
    logs = [NS0 + (k // 10 * 10 + 10) * 16_666_667 + (k % 10) * 20_000 for k in range(len(rows))]
    bare = [(log, {"pose": m["pose"]}) for log, (_, m) in zip(logs, rows, strict=True)]
    yield "mcap: poses in bursts of 10, log time only", lab.mcap(bare, lab.commands(stamped=False))
    jitter = np.random.default_rng(0).uniform(0, 0.012, len(lab.T))
    yield "mcap: stamps jitter 12 ms", lab.mcap(lab.poses(lab.T + jitter))


@row(20)
def _(lab: Lab) -> Tries:
    for label, value in (("zero", 0), ("2^63", 2**63), ("2^64-1", 2**64 - 1)):
        rows = lab.poses()
        for i in (100, 200, 300):
            rows[i][1]["timestamp"] = stamp(value)
        yield f"mcap: 3 header stamps {label}", lab.mcap(rows)
    rows = [(0, m) for _, m in lab.poses()]
    for _, m in rows:
        m["timestamp"] = stamp(0)
    yield "mcap: every pose stamp zero", lab.mcap(rows)
    rows = [(log, {**m, "timestamp": stamp(0)}) for log, m in lab.poses()]
    yield "mcap: all header stamps zero, log good", lab.mcap(rows)
    rows = [(log, {**m, "timestamp": stamp(((log - 8_000_000) // 1000 % 2**32) * 1000)}) for log, m in lab.poses()]
    yield "mcap: stamps roll over (uint32 us)", lab.mcap(rows)
    rows = [
        (log, {**m, "timestamp": stamp((round(s * 1e6) + 2**32 - 15_000_000) % 2**32 * 1000)})
        for s, (log, m) in zip(lab.T, lab.poses(), strict=True)
    ]
    cmd = [
        (log, {**m, "timestamp": stamp((round(s * 1e6) + 2**32 - 15_000_000) % 2**32 * 1000)})
        for s, (log, m) in zip(lab.TC, lab.commands(), strict=True)
    ]
    yield "mcap: both streams roll over at 15 s (uint32 us)", lab.mcap(rows, cmd)
    rows = lab.poses()
    rows[0][1]["timestamp"] = stamp(0)
    yield "mcap: first pose stamp zero", lab.mcap(rows)


@row(21)
def _(lab: Lab) -> Tries:
    rows = [(log, {**m, "timestamp": stamp(log - 8_000_000 - NS0)}) for log, m in lab.poses()]
    yield "mcap: pose stamps sim time, commands wall", lab.mcap(rows)
    rows = [
        (log, {**m, "timestamp": stamp(log - 8_000_000 - NS0 if i > 900 else log - 8_000_000)})
        for i, (log, m) in enumerate(lab.poses())
    ]
    yield "mcap: pose stamps change base half way", lab.mcap(rows)
    slow = [(log, {**m, "timestamp": stamp(NS0 + (log - 8_000_000 - NS0) // 2)}) for log, m in lab.poses()]
    fast = [(log, {**m, "timestamp": stamp(NS0 + (log - NS0) // 2)}) for log, m in lab.commands()]
    yield "mcap: header stamps at half the log's speed", lab.mcap(slow, fast)


@row(31)
def _(lab: Lab) -> Tries:
    k = (lab.TC < 10) | (lab.TC > 12)
    yield "mcap: 2 s without commands", lab.mcap(None, lab.commands(lab.TC[k], lab.C[k]))
    k = ((lab.TC < 8) | (lab.TC > 9.5)) & ((lab.TC < 20) | (lab.TC > 21))
    yield "mcap: two gaps of the commands", lab.mcap(None, lab.commands(lab.TC[k], lab.C[k]))
    seen = (lab.T < 12) | (lab.T > 16)
    lost = lab.poses(lab.T[seen], lab.P[seen], lab.Q[seen])
    yield "mcap: two gaps of the commands, 4 s of the poses", lab.mcap(lost, lab.commands(lab.TC[k], lab.C[k]))
    k = lab.TC < 20
    yield "mcap: commands end 10 s early", lab.mcap(None, lab.commands(lab.TC[k], lab.C[k]))
    k = lab.TC > 10
    yield "mcap: commands begin 10 s late", lab.mcap(None, lab.commands(lab.TC[k], lab.C[k]))
