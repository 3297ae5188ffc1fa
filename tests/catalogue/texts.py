"""Rows 44 to 50 and 54 of the catalogue of bad input: texts, names and things that are no file."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

from catalogue.lab import Lab, Rows, Tries
from catalogue.rows import row


@row(44)
def _(lab: Lab) -> Tries:
    bag = lab.folder / "bag"
    bag.mkdir(exist_ok=True)
    shutil.copy(
        lab.mcap(
            [r for r, t in zip(lab.poses(), lab.T, strict=True) if t < 15],
            [r for r, t in zip(lab.commands(), lab.TC, strict=True) if t < 15],
        ),
        bag / "bag_0.mcap",
    )
    (bag / "metadata.yaml").write_text(
        "rosbag2_bagfile_information:\n  relative_file_paths: [bag_0.mcap, bag_1.mcap]\n"
    )
    yield "a bag's folder, one part missing", bag
    yield "its first part alone", bag / "bag_0.mcap"


@row(45)
def _(lab: Lab) -> Tries:
    raw = lab.motive_file.read_text(encoding="utf-8")
    beside = lab.motive_file.with_suffix(".commands.csv").read_bytes()
    for label, data in (
        ("UTF-8 BOM", b"\xef\xbb\xbf" + raw.encode()),
        ("UTF-16 with BOM", raw.encode("utf-16")),
        ("UTF-16 LE without BOM", raw.encode("utf-16-le")),
        ("Latin-1 take name", raw.replace("Take Name,drive", "Take Name,Überfahrt", 1).encode("latin-1")),
        ("Latin-1 byte in the table", raw.encode()[:60000] + b"\xe9" + raw.encode()[60000:]),
    ):
        (lab.folder / "enc.csv").write_bytes(data)
        (lab.folder / "enc.commands.csv").write_bytes(beside)
        yield f"motive: {label}", lab.folder / "enc.csv"
    for label, data in (
        ("UTF-8 BOM", b"\xef\xbb\xbf" + beside),
        ("UTF-16 with BOM", beside.decode().encode("utf-16")),
        ("Latin-1 header", beside.replace(b"throttle_mps", b"throttle_mps,Gr\xf6sse", 1)),
    ):
        (lab.folder / "enc.csv").write_text(raw, encoding="utf-8")
        (lab.folder / "enc.commands.csv").write_bytes(data)
        yield f"commands: {label}", lab.folder / "enc.csv"
    (lab.folder / "enc_t.csv").write_bytes(b"\xef\xbb\xbf" + lab.table(lambda d: d).read_bytes())
    yield "table: UTF-8 BOM", lab.folder / "enc_t.csv", lab.tabled


@row(46)
def _(lab: Lab) -> Tries:
    raw = lab.motive_file.read_text(encoding="utf-8")
    head, body = raw.split("Frame,", 1)
    semi = (head + "Frame," + body.replace("Time (Seconds)", "Time (Seconds)")).replace(",", ";").replace(".", ",")
    (lab.folder / "semi.csv").write_text(semi, encoding="utf-8")
    (lab.folder / "semi.commands.csv").write_bytes(lab.motive_file.with_suffix(".commands.csv").read_bytes())
    yield "motive: ; and decimal comma", lab.folder / "semi.csv"
    (lab.folder / "semi.csv").write_text(raw, encoding="utf-8")
    commands_text = lab.motive_file.with_suffix(".commands.csv").read_text()
    (lab.folder / "semi.commands.csv").write_text(commands_text.replace(",", ";").replace(".", ","))
    yield "commands: ; and decimal comma", lab.folder / "semi.csv"
    (lab.folder / "semi.commands.csv").write_text(commands_text.replace(",", ";"))
    yield "commands: ; and decimal point", lab.folder / "semi.csv"
    lines = commands_text.splitlines()
    (lab.folder / "semi.commands.csv").write_text(
        "\n".join([lines[0], *(",".join(f'"{c.replace(".", ",")}"' for c in line.split(",")) for line in lines[1:])])
    )
    yield 'commands: "0,5" quoted decimal comma', lab.folder / "semi.csv"
    (lab.folder / "semi.commands.csv").write_text(
        "\n".join([lines[0], *(line.replace(".", ",") for line in lines[1:])])
    )
    yield "commands: decimal comma, comma separated", lab.folder / "semi.csv"
    yield "table: ; and decimal comma", lab.table(lambda d: d, sep=";", decimal=","), lab.tabled
    yield "table: tab", lab.table(lambda d: d, sep="\t"), lab.tabled
    yield (
        "table: thousands 1,234.5 quoted",
        lab.table(lambda d: d.assign(px=[f"{1000 + x:,.3f}" for x in d.px])),
        lab.tabled,
    )


@row(47)
def _(lab: Lab) -> Tries:
    raw = lab.motive_file.read_bytes()
    beside = lab.motive_file.with_suffix(".commands.csv").read_bytes()
    ended = raw.rstrip(b"\r\n")
    last = ended.rsplit(b"\r\n", 1)[1]

    def with_files(a: bytes, b: bytes) -> Path:
        (lab.folder / "cut.csv").write_bytes(a)
        (lab.folder / "cut.commands.csv").write_bytes(b)
        return lab.folder / "cut.csv"

    yield (
        "motive: last row cut after 4 cells",
        with_files(ended[: -len(last)] + b",".join(last.split(b",")[:4]), beside),
    )
    yield (
        "motive: last row cut in a position's number",
        with_files(ended[: -len(last)] + b",".join(last.split(b",")[:8])[:-5], beside),
    )
    yield (
        "motive: last row cut in Z (1.234567 -> 1.)",
        with_files(ended[: -len(last)] + b",".join(last.split(b",")[:9])[:-6], beside),
    )
    yield (
        "motive: last row cut to '-'",
        with_files(ended[: -len(last)] + b",".join(last.split(b",")[:6]) + b",-", beside),
    )
    yield "motive: cut inside the frame number", with_files(ended[: -len(last)] + last[:2], beside)
    yield (
        "motive: a row cut in the middle of the file",
        with_files(raw[:60000].rsplit(b",", 3)[0] + raw[60000:][raw[60000:].index(b"\r\n") :], beside),
    )
    yield "motive: 64 NULs at the end", with_files(raw + bytes(64), beside)
    yield "motive: 64 NULs inside", with_files(raw[:60000] + bytes(64) + raw[60064:], beside)
    yield (
        "motive: a NUL row inside",
        with_files(
            raw[:60000].rsplit(b"\r\n", 1)[0] + b"\r\n" + bytes(40) + b"\r\n" + raw[60000:].split(b"\r\n", 1)[1], beside
        ),
    )
    lines = beside.rstrip().split(b"\n")
    yield (
        "commands: last row cut after the 2nd cell",
        with_files(raw, b"\n".join([*lines[:-1], b",".join(lines[-1].split(b",")[:2])])),
    )
    yield "commands: last row cut in the number", with_files(raw, beside.rstrip()[:-5])
    yield "commands: NULs at the end", with_files(raw, beside + bytes(64))
    yield "commands: NULs inside a number", with_files(raw, beside[:5000] + bytes(3) + beside[5003:])
    text = lab.table(lambda d: d).read_bytes()
    (lab.folder / "cut_t.csv").write_bytes(text[:-40])
    yield "table: last row cut", lab.folder / "cut_t.csv", lab.tabled
    (lab.folder / "cut_t.csv").write_bytes(text[:60000] + bytes(30) + text[60030:])
    yield "table: NULs inside", lab.folder / "cut_t.csv", lab.tabled


@row(48)
def _(lab: Lab) -> Tries:
    raw = lab.motive_file.read_bytes()
    (lab.folder / "two.csv").write_bytes(raw + raw)
    (lab.folder / "two.commands.csv").write_bytes(lab.motive_file.with_suffix(".commands.csv").read_bytes())
    yield "motive: two exports in one file", lab.folder / "two.csv"
    text = lab.table(lambda d: d).read_bytes()
    (lab.folder / "two_t.csv").write_bytes(text + text)
    yield "table: two with headers", lab.folder / "two_t.csv", lab.tabled
    (lab.folder / "two_t.csv").write_bytes(text + text.split(b"\n", 1)[1])
    yield "table: rows twice, no second header", lab.folder / "two_t.csv", lab.tabled
    yield "motive: second take's rows without a header", lab.motive(lambda rows: [*rows, *[list(r) for r in rows[7:]]])
    shifted = lab.table(lambda d: d.assign(px=d.px + 1, t=d.t + 0.005), name="two_s").read_bytes()
    (lab.folder / "two_t.csv").write_bytes(text + shifted.split(b"\n", 1)[1])
    yield "table: another take's rows, stamps between", lab.folder / "two_t.csv", lab.tabled


@row(49)
def _(lab: Lab) -> Tries:
    for label, name in (
        ("a, b", "a, b"),
        ('quotes "x"', 'a "x" b'),
        ("newline", "a\nb"),
        ("three newlines", "a\n\n\nb"),
    ):

        def named(rows: Rows, name: str = name) -> None:
            rows[0][rows[0].index("Take Name") + 1] = name

        yield f"motive: take name with {label}", lab.motive(named)
    for label, name in (("a comma", "car, red"), ("a newline", "car\nred")):

        def body(rows: Rows, name: str = name) -> Rows:
            return [[c.replace("bumper_car", name) for c in r] for r in rows]

        yield f"motive: body's name with {label}", lab.motive(body), lab.veh(mocap={"rigid_body": name})


@row(50)
def _(lab: Lab) -> Tries:
    def body(rows: Rows) -> Rows:
        return [[c.replace("bumper_car", "[/red]\x1b[31m<script>") for c in r] for r in rows]

    yield "motive: body named [/red]ESC<script>", lab.motive(body)
    (lab.folder / "hostile").mkdir()
    target = lab.folder / "hostile" / "[bold]x\x1b[31m<b>=CMD.csv"
    shutil.copy(lab.motive_file, target)
    shutil.copy(lab.motive_file.with_suffix(".commands.csv"), target.with_suffix(".commands.csv"))
    yield "a file named [bold]ESC<b>=CMD", target


@row(54)
def _(lab: Lab) -> Tries:
    (lab.folder / "folder").mkdir()
    (lab.folder / "folder" / "b.mcap").write_bytes(b"")
    yield "a folder", lab.folder / "folder"
    fifo = lab.folder / "fifo.csv"
    os.mkfifo(fifo)
    yield "a FIFO", fifo
    yield "/dev/zero", Path("/dev/zero")
    loop = lab.folder / "loop.csv"
    loop.symlink_to(loop)
    yield "a symlink to itself", loop
    yield "a dangling symlink's name, NUL in it", Path("a\0b.csv")
    yield "a name of 5000 characters", Path("a" * 5000)
    shutil.copy(lab.motive_file, lab.folder / "fc.csv")
    beside = lab.folder / "fc.commands.csv"
    os.mkfifo(beside)
    yield "commands file a FIFO", lab.folder / "fc.csv"
    beside.unlink()
    beside.mkdir()
    yield "commands file a folder", lab.folder / "fc.csv"
