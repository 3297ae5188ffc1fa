"""Rows 81 to 88 of the catalogue: tables of other programs, quotes, notations, rows of their own, and lost poses."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from catalogue.lab import COLUMNS, Floats, Lab, Tries, cells
from catalogue.rows import row


def lines_of(lab: Lab) -> list[str]:
    """The lines of the clean table, without the header."""
    return lab.table(lambda d: d.round(6)).read_text(encoding="utf-8").splitlines()[1:]


HEAD = ",".join(COLUMNS.values())


def text_file(lab: Lab, head: str, lines: list[str]) -> Path:
    """A table of this text."""
    return lab.bytes_file("x.csv", "\n".join([head, *lines, ""]).encode())


@row(81)
def _(lab: Lab) -> Tries:
    lines = lines_of(lab)
    noted = [f"{line},n{i}" for i, line in enumerate(lines)]
    swallowing = [*noted[:500], noted[500] + ' 5"', *noted[501:]]
    opened = [*noted[:500], noted[500].replace(",n", ',"n'), *noted[501:-1], noted[-1] + '"']
    for label, rows in (
        ("an inch sign in a note", swallowing),
        ("a quotation mark swallows rows", opened),
        ("a quoted note with a line end", [*noted[:500], noted[500].replace(",n", ',"n\nn') + '"', *noted[501:]]),
        ("a row cut, beside quoted notes", [*[f'{n[:-1]}"q"' for n in noted[:500]], lines[500][:25], *noted[501:]]),
        ("two rows in one line", [*noted[:500], noted[500] + noted[501], *noted[502:]]),
    ):
        yield f"table: {label}", text_file(lab, f"{HEAD},note", rows), lab.tabled

    export = lab.motive_file.read_text(encoding="utf-8").splitlines()
    named = next(i for i, line in enumerate(export) if ",ID," in line)
    export[named] = ",".join(f'"{c}"' if i > 1 else c for i, c in enumerate(export[named].split(",")))
    export[500] = export[500].rpartition(",")[0][:-4]
    yield "motive: quoted IDs, a row cut", lab.two_files("quoted", "\n".join(export).encode())


@row(82)
def _(lab: Lab) -> Tries:
    lines = lines_of(lab)
    for label, head, rows in (
        ("sep=, first", f"sep=,\n{HEAD}", lines),
        ("two lines above the header", f"Logger: run 7\nDate: 4 May 2026\n\n{HEAD}", lines),
        ("a row of units", f"{HEAD}\ns,m,m,rad,rad,m/s", lines),
        ("a row of other units", f"{HEAD}\ns,mm,mm,deg,rad,m/s", lines),
        ("two header rows", f",car,,,command,\n{HEAD}", lines),
        ("blanks behind names", HEAD.replace(",", " , "), lines),
        ("blanks between cells", HEAD.replace(",", " "), [line.replace(",", " ") for line in lines]),
        ("a header behind #", f"# {HEAD}", lines),
        ("comment lines inside", HEAD, [*lines[:500], "# lap 2", *lines[500:]]),
        ("no header", lines[0], lines[1:]),
        ("a column without a name", HEAD, [f"{i},{line}" for i, line in enumerate(lines)]),
    ):
        yield f"table: {label}", text_file(lab, head, rows), lab.tabled


@row(83)
def _(lab: Lab) -> Tries:
    for label, write in (
        ("typographic minus signs", lambda v: f"{v:.6f}".replace("-", "\N{MINUS SIGN}")),
        ("Fortran's exponents", lambda v: f"{v:.8E}".replace("E", "D")),
        ("decimal commas in quotes", lambda v: f"{v:.6f}".replace(".", ",")),
        ("units in cells", lambda v: f"{v:.6f} rad"),
        ("percent signs", lambda v: f"{100 * v:.4f} %"),
        ("underscores", lambda v: f"0_{abs(v):.6f}"),
    ):
        yield f"table: steering with {label}", lab.table(lambda d, w=write: d.assign(steer=d.steer.map(w))), lab.tabled
    yield "table: TRUE as the throttle", lab.table(lambda d: d.assign(gas="TRUE")), lab.tabled
    narrow = lab.table(lambda d: d.assign(px=d.px.round(6).astype(str).mask(d.index == 99, "########")))
    yield "table: a spreadsheet's narrow column", narrow, lab.tabled


@row(84)
def _(lab: Lab) -> Tries:
    def clock(t: Floats, start_s: float) -> list[str]:
        day = pd.Timestamp("2026-05-04")
        return [(day + pd.Timedelta(seconds=float(start_s + s))).strftime("%H:%M:%S.%f") for s in t]

    for label, write in (
        ("ISO 8601", lambda t: [f"2026-05-04T{c}Z" for c in clock(t, 5e4)]),
        ("Unix ns", lambda t: [1_780_000_000_000_000_000 + round(s * 1e9) for s in t]),
        ("clock times past midnight", lambda t: clock(t, 86_390.0)),
        ("seconds of the day past midnight", lambda t: (86_390.0 + t) % 86_400.0),
        ("text", lambda t: [f"frame {round(60 * s)}" for s in t]),
    ):
        yield f"table: stamps as {label}", lab.table(lambda d, w=write: d.assign(t=w(d.t.to_numpy()))), lab.tabled
    pair = lab.table(lambda d: d.assign(t=d.t // 1 + 1.78e9, nano=(d.t % 1 * 1e9).round().astype(int)).rename(
        columns={"t": "t.sec", "nano": "t.nanosec"}
    ))  # fmt: skip
    yield "table: seconds and nanoseconds in two columns", pair, lab.tabled


@row(85)
def _(lab: Lab) -> Tries:
    sent = np.searchsorted(lab.T, lab.TC)

    def apart(d: pd.DataFrame) -> pd.DataFrame:
        poses = d.assign(steer=np.nan, gas=np.nan)
        rows = sent[sent < len(d)]
        commands = d.iloc[rows].assign(t=d.t.iloc[rows] + 0.003, px=np.nan, py=np.nan, psi=np.nan)
        return pd.concat([poses, commands]).sort_values("t")

    yield "table: poses and commands in rows of their own", lab.table(apart), lab.tabled
    yield "table: poses blank for 1 s among full rows", lab.table(
        lambda d: d.assign(**{c: d[c].mask(d.index.isin(range(600, 660))) for c in ("px", "py", "psi")})
    ), lab.tabled  # fmt: skip


@row(86)
def _(lab: Lab) -> Tries:
    gone = np.isin(np.arange(len(lab.T)), [300, *range(600, 660), *range(900, 905)])
    for label, value in (("zeros", 0.0), ("-9999", -9999.0)):
        p = np.where(gone[:, None], value, lab.P)
        yield f"table: lost poses as {label}", lab.table(
            lambda d, p=p: d.assign(px=p[:, 0], py=p[:, 1], psi=p[:, 2])
        ), lab.tabled  # fmt: skip

    def zeros(x: Floats) -> None:
        x[600:660, :7] = 0.0

    yield "motive: lost poses as zeros", lab.motive(cells(zeros))
    q = np.where(gone[:, None], [0.0, 0.0, 0.0, 1.0], lab.Q)
    yield "mcap: lost poses at the origin", lab.mcap(lab.poses(p=np.where(gone[:, None], 0.0, lab.P), q=q))


@row(87)
def _(lab: Lab) -> Tries:
    mm = lab.table(lambda d: d.assign(px=1000 * d.px, py=1000 * d.py))
    yield "table: positions in mm, and nothing says so", mm, lab.tabled
    yield "table: positions in mm by length_unit", mm, lab.veh(columns=COLUMNS, mocap={"length_unit": "mm"})
    frame = pd.read_csv(lab.table(lambda d: d))
    path = lab.folder / "p.parquet"
    pq.write_table(pa.table(dict(frame)), path)
    yield "parquet: no page checksums", path, lab.tabled
    pq.write_table(pa.table([*dict(frame).values(), frame.px], names=[*frame.columns, "px"]), path)
    yield "parquet: a column twice", path, lab.tabled
    pq.write_table(pa.table({**frame, "gas": pa.array(frame.gas > 0.0)}), path, write_page_checksum=True)
    yield "parquet: true and false as the throttle", path, lab.tabled


@row(88)
def _(lab: Lab) -> Tries:
    commands = pd.read_csv(lab.motive_file.with_suffix(".commands.csv"))

    def beside(frame: pd.DataFrame, header: bool = True) -> bytes:
        return str(frame.to_csv(index=False, header=header)).encode()

    unix = commands.assign(time_s=commands.time_s + 1_780_000_000.25)
    other = commands.set_axis(["Time (s)", "Steering [rad]", "Throttle"], axis=1)
    start = pd.Timestamp("2026-05-04 14:15:30.125")
    dates = commands.assign(time_s=start + pd.to_timedelta(commands.time_s, unit="s"))
    mapped = {"time_s": "Time (s)", "steering_rad": "Steering [rad]", "throttle_mps": "Throttle"}
    yield "commands: Unix time", lab.two_files("k", commands=beside(unix))
    yield "commands: Unix time, time_zero says", lab.two_files("k", commands=beside(unix)), lab.veh(
        commands={"time_zero": 1_780_000_000.25}
    )  # fmt: skip
    yield "commands: dates", lab.two_files("k", commands=beside(dates))
    yield "commands: other names", lab.two_files("k", commands=beside(other))
    yield "commands: other names, mapped", lab.two_files("k", commands=beside(other)), lab.veh(commands=mapped)
    yield "commands: no header", lab.two_files("k", commands=beside(commands, header=False))
    for name in ("take.tak", "take.c3d", "take.xlsx", "take.mat", "take.npz"):
        yield f"a file named {name}", lab.bytes_file(name, b"\x00\x01" * 100)
