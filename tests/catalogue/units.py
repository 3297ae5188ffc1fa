"""Rows 22 to 28 and 51 of the catalogue of bad input: units, signs, axes, and drives that show too little."""

from __future__ import annotations

import numpy as np

from catalogue.lab import NS0, Floats, Lab, Rows, Tries, about_z, cells
from catalogue.rows import row


@row(22)
def _(lab: Lab) -> Tries:
    for f in (1000.0, 100.0, 10.0, 0.01, 0.001):
        p = lab.P.copy()
        p[:, :2] *= f
        yield f"mcap: lengths x {f:g}", lab.mcap(lab.poses(p=p))

    def mm(rows: Rows) -> None:
        cells(lambda x: x * np.r_[np.ones(4), np.full(4, 1000.0)])(rows)
        rows[0][rows[0].index("Length Units") + 1] = "Millimeters"

    yield "motive: mm, header says so", lab.motive(mm)


@row(23)
def _(lab: Lab) -> Tries:
    for f in (1.1, 1.5, 2.0, 3.0, 0.5):
        p = lab.P.copy()
        p[:, :2] *= f
        yield f"mcap: lengths x {f:g}", lab.mcap(lab.poses(p=p))


@row(24)
def _(lab: Lab) -> Tries:
    yield "motive: Y-up file, up_axis = Z", lab.motive_file, lab.veh(mocap={"up_axis": "Z"})

    def swap(x: Floats) -> Floats:  # positions Z-up, quaternions Y-up: one of the two turned
        y = x.copy()
        y[:, 5], y[:, 6] = -x[:, 6], x[:, 5]
        return y

    yield "motive: positions Z-up, quaternions Y-up", lab.motive(cells(swap))
    for label, s in (("x", [-1, 1, 1]), ("y", [1, -1, 1]), ("yaw", [1, 1, -1])):
        p = lab.P * s
        q = about_z(p[:, 2])
        yield f"mcap: {label} mirrored", lab.mcap(lab.poses(p=p, q=q))
    p = lab.P * [1, -1, -1]
    q = about_z(p[:, 2])
    yield (
        "mcap: y and yaw mirrored, steering inverted too",
        lab.mcap(lab.poses(p=p, q=q), lab.commands(c=lab.C * [-1, 1])),
    )
    p = lab.P.copy()
    p[:, [0, 1]] = lab.P[:, [1, 0]]
    yield "mcap: x and y exchanged (det -1)", lab.mcap(lab.poses(p=p))
    yield (
        "motive: floor tilted 0.6 rad",
        lab.motive(cells(lambda x: np.column_stack([x[:, :4], x[:, 4], x[:, 5] + 0.5 * x[:, 6], x[:, 6:]]))),
    )


@row(25)
def _(lab: Lab) -> Tries:
    yield "mcap: steering in degrees", lab.mcap(None, lab.commands(c=lab.C * [57.29578, 1]))
    yield "mcap: steering in degrees, small angles x 0.05", lab.mcap(None, lab.commands(c=lab.C * [57.29578 * 0.05, 1]))
    yield (
        "table: yaw in degrees, wrapped",
        lab.table(lambda d: d.assign(psi=np.degrees(np.angle(np.exp(1j * d.psi))))),
        lab.tabled,
    )
    yield (
        "table: yaw and steering in degrees, throttle in percent",
        lab.table(lambda d: d.assign(psi=np.degrees(d.psi), steer=np.degrees(d.steer), gas=50.0 * d.gas), "all_of_it"),
        lab.tabled,
    )
    yield "table: yaw in degrees, unwrapped", lab.table(lambda d: d.assign(psi=np.degrees(d.psi))), lab.tabled
    extra = [
        (
            log,
            {
                **m,
                "yaw_rate_radps": 57.3 * 0.5,
                "measured_steering_rad": 57.3 * m["steering_rad"],
                "wheel_speed_mps": 1000.0,
            },
        )
        for log, m in lab.commands()
    ]
    yield "mcap: channels in deg, deg/s, mm/s", lab.mcap(None, extra)

    def radians(rows: Rows) -> None:
        from scipy.spatial.transform import Rotation

        rows[0][rows[0].index("Rotation Type") + 1] = "XYZ"
        for r in rows[2:6]:
            del r[5]
        del rows[6][5]
        for r in rows[7:]:
            r[2:6] = (
                [""] * 3
                if not r[2]
                else [f"{a:.6f}" for a in Rotation.from_quat([float(c) for c in r[2:6]]).as_euler("XYZ")]
            )

    yield "motive: Euler angles in radians", lab.motive(radians)


@row(26)
def _(lab: Lab) -> Tries:
    yield "mcap: steering inverted", lab.mcap(None, lab.commands(c=lab.C * [-1, 1]))
    extra = [(log, {**m, "measured_steering_rad": -m["steering_rad"]}) for log, m in lab.commands()]
    yield "mcap: measured steering inverted", lab.mcap(None, extra)
    extra = [
        (log, {**m, "yaw_rate_radps": float(-np.interp((log - NS0) / 1e9, lab.T, np.gradient(lab.P[:, 2], lab.T)))})
        for log, m in lab.commands()
    ]
    yield "mcap: gyro inverted", lab.mcap(None, extra)


@row(27)
def _(lab: Lab) -> Tries:
    def local(rows: Rows) -> None:
        rows[0][rows[0].index("Coordinate Space") + 1] = "Local"

    yield "motive: Local", lab.motive(local)


@row(28)
def _(lab: Lab) -> Tries:
    def rate(rows: Rows) -> None:
        rows[0][rows[0].index("Capture Frame Rate") + 1] = "240.000000"

    yield "motive: capture 240, export 60", lab.motive(rate)


@row(51)
def _(lab: Lab) -> Tries:
    n = 1800
    t = np.arange(n) / 60
    p = np.column_stack([np.cumsum(np.clip(t, 0, 1.2)) / 60, 0 * t, 0 * t])
    q = np.tile([0.0, 0, 0, 1], (n, 1))
    tc = np.arange(600) / 20
    yield "mcap: straight line", lab.mcap(lab.poses(t, p, q), lab.commands(tc, np.tile([0.0, 1.2], (600, 1))))
    yield "mcap: car at rest", lab.mcap(lab.poses(t, 0 * p, q), lab.commands(tc, np.zeros((600, 2))))
