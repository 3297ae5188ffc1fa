"""Rows 61 to 65 of the catalogue of bad input: yaws and mountings that jump, poses that are held, bodies set askew."""

from __future__ import annotations

import numpy as np

from catalogue.lab import Floats, Lab, Tries, about_z, cells
from catalogue.rows import row


def turned(lab: Lab, rows: Floats, rad: float) -> Floats:
    """Quaternions of the drive with the yaw turned in some rows."""
    return about_z(lab.P[:, 2] + rad * rows)


@row(61)
def _(lab: Lab) -> Tries:
    spikes = np.isin(np.arange(len(lab.T)), range(100, 1700, 85))
    for degrees in (20.0, 143.0):
        q = turned(lab, spikes, np.radians(degrees))
        yield f"mcap: yaw + {degrees:g} deg in 19 samples", lab.mcap(lab.poses(q=q))
    for degrees, seconds in ((60.0, 0.5), (90.0, 3.0)):
        label = f"mcap: yaw + {degrees:g} deg for {seconds:g} s"
        yield label, lab.mcap(lab.poses(q=turned(lab, lab.mid(10, 10 + seconds), np.radians(degrees))))
    for value in (1e5, 357.0):
        yield (
            f"table: one yaw is {value:g}",
            lab.table(lambda d, value=value: d.assign(psi=d.psi.where(d.index != 500, value))),
            lab.tabled,
        )
    many = np.random.default_rng(0).random(len(lab.T)) < 0.1
    yield "mcap: yaw + 120 deg in 10 % of the samples", lab.mcap(lab.poses(q=turned(lab, many, 2.1)))


@row(62)
def _(lab: Lab) -> Tries:
    late = lab.mid(20, 99)
    yield "mcap: yaw + 60 deg from 20 s on", lab.mcap(lab.poses(q=turned(lab, late, np.radians(60.0))))
    p = lab.P + np.outer(late, [0.01, -0.008, 0.12])
    yield "mcap: a marker knocked at 20 s (0.12 rad, 13 mm)", lab.mcap(lab.poses(p=p, q=about_z(p[:, 2])))
    p = lab.P + np.outer(late, [0.03, -0.02, 0.0])
    yield "mcap: a marker knocked at 20 s (36 mm)", lab.mcap(lab.poses(p=p))
    c, s = np.cos(0.5), np.sin(0.5)
    p = lab.P.copy()
    p[late, :2] = p[late, :2] @ np.array([[c, s], [-s, c]]) + [1.0, 2.0]
    p[late, 2] += 0.5
    yield "mcap: the tracking's axes set anew at 20 s", lab.mcap(lab.poses(p=p, q=about_z(p[:, 2])))


@row(63)
def _(lab: Lab) -> Tries:
    for samples in (1, 5, 13):
        p, q = lab.P.copy(), lab.Q.copy()
        for k in range(600, 1600, 40):
            p[k : k + samples], q[k : k + samples] = p[k - 1], q[k - 1]
        yield f"mcap: poses held for {samples} samples, 25 times", lab.mcap(lab.poses(p=p, q=q))
    k = lab.mid(10, 12)
    q = lab.Q.copy()
    q[k] = q[k][0]
    yield "mcap: only the yaw held for 2 s", lab.mcap(lab.poses(q=q))
    yield "mcap: yaw all zero", lab.mcap(lab.poses(q=about_z(0.0 * lab.T)))
    yield "table: poses rounded to mm and mrad", lab.table(lambda d: d.round({"px": 3, "py": 3, "psi": 3})), lab.tabled


@row(64)
def _(lab: Lab) -> Tries:
    yaw = np.angle(np.exp(1j * lab.P[:, 2]))
    u = lab.C[np.maximum(np.searchsorted(lab.TC, lab.T, side="right") - 1, 0)]

    def resampled(rate_hz: float) -> Floats:
        t = np.arange(0.0, lab.T[-1], 1.0 / rate_hz)
        poses = [np.interp(t, lab.T, column) for column in (*lab.P[:, :2].T, yaw)]
        held = u[np.searchsorted(lab.T, t, side="right") - 1]
        return np.column_stack([t, *poses, held])

    for rate_hz in (100.0, 240.0):
        again = resampled(rate_hz)
        yield (
            f"table: wrapped yaw resampled to {rate_hz:g} Hz by lines",
            lab.table(lambda d, again=again: type(d)(again, columns=d.columns)),
            lab.tabled,
        )


@row(65)
def _(lab: Lab) -> Tries:
    from scipy.spatial.transform import Rotation

    for label, mounted in (
        ("leans by 0.6 rad", (0.0, 0.6, 0.0)), ("is upside down", (0.0, 0.0, np.pi)),
        ("has X nearly up", (0.0, 1.5, 0.4)), ("has X up", (0.0, np.pi / 2, 0.0)),
    ):  # fmt: skip
        askew = Rotation.from_quat(lab.Q) * Rotation.from_euler("ZYX", mounted)
        yield f"mcap: the body {label}", lab.mcap(lab.poses(q=askew.as_quat()))

    def other_axes(x: Floats) -> None:
        x[:, 1:3] = x[:, [2, 1]]

    yield "motive: quaternions about Z, Y up", lab.motive(cells(other_axes))
