"""Rows 1 to 12 and 52 of the catalogue of bad input: poses that are none, or not the car's."""

from __future__ import annotations

import numpy as np

from catalogue.lab import Floats, Lab, Rows, Tries, about_z, cells, texts
from catalogue.rows import row


@row(1)
def _(lab: Lab) -> Tries:
    def flip(x: Floats) -> None:
        x[::3, :4] *= -1

    yield "motive: every third q negated", lab.motive(cells(flip))
    q = lab.Q.copy()
    q[::3] *= -1
    yield "mcap: every third q negated", lab.mcap(lab.poses(q=q))


@row(2)
def _(lab: Lab) -> Tries:
    for label, n, f in (
        ("norm 1.0005 (all)", slice(None), 1.0005),
        ("norm 1.3, 5 rows", slice(100, 105), 1.3),
        ("norm 1.3, 3 %", slice(100, 154), 1.3),
        ("zero, 5 rows", slice(100, 105), 0.0),
        ("zero, 3 %", slice(100, 154), 0.0),
    ):
        q = lab.Q.copy()
        q[n] *= f
        yield f"mcap: {label}", lab.mcap(lab.poses(q=q))
    q = lab.Q.copy()
    q[100:154] = np.random.default_rng(0).normal(size=(54, 4)) * 3  # garbage, far from unit
    yield "mcap: garbage non-unit q, 3 %", lab.mcap(lab.poses(q=q))

    def zero(x: Floats) -> None:
        x[100:105, :4] = 0

    yield "motive: zero, 5 rows", lab.motive(cells(zero))


@row(3)
def _(lab: Lab) -> Tries:
    def wxyz(x: Floats) -> Floats:
        return x[:, [3, 0, 1, 2, 4, 5, 6, 7]]

    yield "motive: w first under X,Y,Z,W", lab.motive(cells(wxyz))
    yield "mcap: w first", lab.mcap(lab.poses(q=lab.Q[:, [3, 0, 1, 2]]))


@row(4)
def _(lab: Lab) -> Tries:
    p, q = lab.P.copy(), lab.Q.copy()
    k = lab.mid(10, 11.5)
    q[k] = about_z(lab.P[:, 2] + np.pi)[k]
    yield "mcap: yaw + 180 deg for 1.5 s", lab.mcap(lab.poses(p=p, q=q))
    k = lab.mid(10, 99)
    q = lab.Q.copy()
    q[k] = about_z(lab.P[:, 2] + np.pi)[k]
    yield "mcap: yaw + 180 deg from 10 s on", lab.mcap(lab.poses(p=p, q=q))


@row(5)
def _(lab: Lab) -> Tries:
    for jump in (1.0, 3.0):
        p = lab.P.copy()
        p[lab.mid(10, 12), 0] += jump
        yield f"mcap: other body {jump:g} m away for 2 s", lab.mcap(lab.poses(p=p))
    p, q = lab.P.copy(), lab.Q.copy()
    k = lab.mid(10, 14)
    p[k], q[k] = lab.P[k][0], lab.Q[k][0]
    yield "mcap: static ghost 4 s, no jump into it", lab.mcap(lab.poses(p=p, q=q))
    p[k] += [3.0, 0, 0]
    yield "mcap: static ghost 4 s, 3 m away", lab.mcap(lab.poses(p=p, q=q))


@row(6)
def _(lab: Lab) -> Tries:
    yaw = lab.P[:, 2] + 0.25
    yield "mcap: yaw + 0.25 rad throughout", lab.mcap(lab.poses(q=about_z(yaw)))
    yield "same, yaw_offset_rad = 0.25 in the file", lab.folder / "b.mcap", lab.veh(mocap={"yaw_offset_rad": 0.25})


@row(7)
def _(lab: Lab) -> Tries:
    yield "table: yaw wrapped to (-pi, pi]", lab.table(lambda d: d.assign(psi=np.angle(np.exp(1j * d.psi)))), lab.tabled
    yield "table: yaw in [0, 2 pi)", lab.table(lambda d: d.assign(psi=np.mod(d.psi, 2 * np.pi))), lab.tabled


@row(8)
def _(lab: Lab) -> Tries:
    def frozen(x: Floats) -> None:
        x[600:720] = x[600]

    yield "motive: frozen for 2 s, commanded", lab.motive(cells(frozen))

    def short(x: Floats) -> None:
        x[600:624] = x[600]

    yield "motive: frozen for 0.4 s", lab.motive(cells(short))


@row(9)
def _(lab: Lab) -> Tries:
    def error(x: Floats) -> None:
        x[600:720, 7] = 0.08
        x[600:720, 4] += 0.05

    yield "motive: marker error 80 mm for 2 s", lab.motive(cells(error))


@row(10)
def _(lab: Lab) -> Tries:
    def marked(rows: Rows) -> None:
        kinds = ["Rigid Body Marker"] * 4
        for i, r in enumerate(rows[2:7]):
            rows[2 + i] = (
                r
                + {
                    0: kinds,
                    1: ["bumper_car_Marker1"] * 4,
                    2: ["x"] * 4,
                    3: ["Position"] * 3 + ["Marker Quality"],
                    4: ["X", "Y", "Z", ""],
                }[i]
            )
        for i, r in enumerate(rows[7:]):
            marker = r[6:9] or ["0"] * 3
            if 600 <= i < 660:
                r[2:10] = [""] * 8
            r += [*(marker if r[6] else ["1", "2", "3"]), "0.0"]

    yield "motive: marker columns solved in 1 s occlusion", lab.motive(marked)

    def held(rows: Rows) -> None:
        def same_pose(x: Floats) -> None:
            x[600:660, :7] = x[599, :7]
            x[600:660, 7] = 0.0

        cells(same_pose)(rows)

    yield "motive: body solved flat (error 0) in occlusion", lab.motive(held)


@row(11)
def _(lab: Lab) -> Tries:
    def blank(x: Floats) -> None:
        x[600:660] = np.nan

    yield "motive: 1 s blank", lab.motive(cells(blank))

    def partly(x: Floats) -> None:
        x[600:620, 4] = np.nan

    yield "motive: only X blank, 20 rows", lab.motive(cells(partly))

    def most(x: Floats) -> None:
        x[np.arange(len(x)) % 10 != 0] = np.nan

    yield "motive: 90 % blank", lab.motive(cells(most))
    yield (
        "motive: commands blank in 40 rows",
        lab.motive(
            lambda r: None, commands=lambda c: c.assign(steering_rad=c.steering_rad.mask(c.index.isin(range(100, 140))))
        ),
    )
    yield (
        "table: blank steering alone blanks the row",
        lab.table(lambda d: d.assign(steer=d.steer.mask(d.index.isin(range(100, 140))))),
        lab.tabled,
    )


@row(12)
def _(lab: Lab) -> Tries:
    for text in ("NaN", "inf", "-inf", "1e400", "1.#INF", "-1.#IND", "1.#QNAN", "nan(ind)", "NULL", "None", "#N/A"):
        yield f"motive: {text} in 3 cells", lab.motive(texts([100, 200, 300], 6, text))
    yield "motive: NaN in 10 %", lab.motive(texts(list(range(0, 1800, 10)), 6, "NaN"))
    yield "motive: inf in 10 %", lab.motive(texts(list(range(0, 1800, 10)), 6, "inf"))
    yield (
        "commands: 1.#INF",
        lab.motive(
            lambda r: None, commands=lambda c: c.assign(steering_rad=["1.#INF", *c.steering_rad[1:].astype(str)])
        ),
    )
    rows = lab.poses()
    for i in (100, 200, 300):
        rows[i][1]["pose"]["position"]["x"] = float("nan")
    yield "mcap JSON: NaN", lab.mcap(rows)
    rows[100][1]["pose"]["position"]["x"] = None
    yield "mcap JSON: null", lab.mcap(rows)
    rows[100][1]["pose"]["position"]["x"] = "NaN"
    yield 'mcap JSON: "NaN" as text', lab.mcap(rows)
    rows = lab.poses()
    for i in range(0, 1800, 10):
        rows[i][1]["pose"]["position"]["x"] = float("nan")
    yield "mcap JSON: NaN in 10 %", lab.mcap(rows)


@row(52)
def _(lab: Lab) -> Tries:
    p, q = lab.P.copy(), lab.Q.copy()
    k = lab.mid(10, 14)
    p[k] += np.column_stack(
        [0.5 * np.sin(2 * (lab.T[k] - 10)) ** 2, 0.5 * np.sin(1.5 * (lab.T[k] - 10)) ** 2, 0 * lab.T[k]]
    )
    rows = lab.poses(p=p, q=q)
    for i in np.flatnonzero(k):
        rows[i][1]["pose"]["position"]["z"] = 1.2
    yield "mcap: lifted 0.9 m and carried for 4 s", lab.mcap(rows)

    p = lab.P.copy()
    p[:, 0] += 1.2 * np.clip(lab.T - 12.0, 0.0, 1.0)
    yield "mcap: pushed along for 1 s, two bumps", lab.mcap(lab.poses(p=p))

    def lifted(x: Floats) -> None:
        x[600:840, 5] += 0.9

    yield "motive: lifted 0.9 m for 4 s", lab.motive(cells(lifted))

    def tipped(x: Floats) -> None:
        x[600:840, :4] = [0.7071, 0, 0, 0.7071]

    yield "motive: lies on its side for 4 s", lab.motive(cells(tipped))
