"""Rows 91 to 94 of the catalogue of bad input: commands that the car was not driven by, and another time."""

from __future__ import annotations

import numpy as np
import pandas as pd

from catalogue.lab import Floats, Lab, Tries
from catalogue.rows import row


@row(91)
def _(lab: Lab) -> Tries:
    for late_s in (-3.0, 0.1, 0.5, 1.0):
        yield f"mcap: commands stamped {late_s:+g} s", lab.mcap(command=lab.commands(t=lab.TC + late_s))
    backward: Floats = lab.C[::-1]
    yield "mcap: commands of another drive", lab.mcap(command=lab.commands(c=backward))


@row(92)
def _(lab: Lab) -> Tries:
    late = lab.TC > 15.0
    for label, steering in (
        ("zero", 0.0 * lab.TC), ("frozen from 15 s on", np.where(late, 0.3, lab.C[:, 0])),
        ("of the other sign from 15 s on", np.where(late, -1.0, 1.0) * lab.C[:, 0]), ("halved", 0.5 * lab.C[:, 0]),
    ):  # fmt: skip
        yield f"mcap: steering {label}", lab.mcap(command=lab.commands(c=np.column_stack([steering, lab.C[:, 1]])))


@row(93)
def _(lab: Lab) -> Tries:
    u_m = lab.C[:, 1]
    for label, throttle in (
        ("zero", 0.0 * u_m), ("constant", 0.0 * u_m + u_m.max()), ("of the other sign", -u_m),
        ("as a duty", u_m / u_m.max()), ("in percent", np.maximum(u_m, 0.0) * 100.0),
    ):  # fmt: skip
        yield f"mcap: throttle {label}", lab.mcap(command=lab.commands(c=np.column_stack([lab.C[:, 0], throttle])))
    yield "mcap: steering and throttle swapped", lab.mcap(command=lab.commands(c=lab.C[:, ::-1]))

    def swap(c: pd.DataFrame) -> pd.DataFrame:
        return c.rename(columns={"steering_rad": "throttle_mps", "throttle_mps": "steering_rad"})

    yield "motive: steering and throttle swapped", lab.motive(lambda rows: None, commands=swap)


@row(94)
def _(lab: Lab) -> Tries:
    for label, entries in (
        ("front and rear lever exchanged", {"body": {"cog_to_front_m": 0.33, "cog_to_rear_m": 0.54}}),
        ("wheelbase doubled", {"body": {"cog_to_front_m": 1.08, "cog_to_rear_m": 0.66}}),
        ("marker offset of 0.3 m", {"mocap": {"marker_offset_m": (0.3, 0.1)}}),
        ("rear driven", {"body": {"drive": "rear"}}), ("clock offset of 0.15 s", {"clock": {"offset_s": 0.15}}),
        ("reference speed of 1 m/s", {"motor": {"reference_speed_mps": 1.0}}),
    ):  # fmt: skip
        yield f"vehicle file: {label}", lab.mcap_file, lab.veh(**entries)
    noise = np.random.default_rng(0).standard_normal(lab.P.shape) * [0.1, 0.1, 0.0]
    yield "mcap: positions with 10 cm of noise", lab.mcap(lab.poses(p=lab.P + noise))
