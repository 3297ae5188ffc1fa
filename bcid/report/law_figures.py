"""The missing law as free functions show it before any hypothesis, with its band, and the named law over it.

Colours are those of the other pictures: orange is what the base model lacks, blue what is named.  No text of the input
is drawn.
"""

from typing import Any

import numpy as np
from markupsafe import Markup

from bcid.aliases import Floats
from bcid.documents.diagnosis import ChannelRemainder, DiagnosisDocument, LawCurve
from bcid.report.canvas import AFTER, BEFORE, INK, Picture, add_legend_above, create_panel, render_svg
from bcid.report.formats import VARIABLES, format_number, join_words, plain_name
from bcid.report.limits import LIMITS

LAWS = {
    "fx": ("forward acceleration", "m/s²"), "fy": ("side acceleration", "m/s²"), "mz": ("yaw acceleration", "rad/s²"),
    "motor": ("acceleration along the driven wheels", "m/s²"), "steering": ("angle of the steered wheel", "rad"),
}  # fmt: skip
"""What the law of a channel is, and its unit; other channels have none."""

DIRECTIONS = {
    "front_along": "acceleration along the front wheel", "front_across": "acceleration across the front wheel",
    "rear_across": "acceleration across the rear wheels", "world_x": "acceleration along the floor’s x",
    "world_y": "acceleration along the floor’s y",
}  # fmt: skip
"""What the law of a wave is that acts in another direction than its channel's."""

QUANTITIES = {**VARIABLES, "time": ("time", "s")}
HEIGHT = 3.2  # inches


def draw_missing_laws(diagnosis: DiagnosisDocument) -> list[Picture]:
    """A picture of the missing law in each of the channels that stand out most, at most `LIMITS.max_laws`.

    Left out are those whose curve nowhere leaves its own band around zero.
    """
    parts = [r for r in diagnosis.remainder if r.curve is not None and _tells_something(r.channel, r.curve)]
    first = "The missing law, before any hypothesis"
    titles = [first, *(f"{first}: {LAWS[r.channel][0]}" for r in parts[1:])]
    return [
        Picture(title, _describe(diagnosis, r, r.curve), (_draw(r.channel, r.curve, title),))
        for title, r in zip(titles, parts[: LIMITS.max_laws], strict=False)
        if r.curve is not None
    ]


def _tells_something(channel: str, law: LawCurve) -> bool:
    """Whether a curve can be drawn, and is anywhere farther from zero than its band is wide."""
    x, y, sd = np.array(law.x), np.array(law.y), np.array(law.sd)
    known = channel in LAWS and law.quantity in QUANTITIES and len(y) > 1
    return known and bool(np.isfinite(x + y + sd).all() and (np.abs(y) > LIMITS.band_sd * sd).any())


def _words(channel: str, law: LawCurve) -> tuple[str, str]:
    """What a law is and its unit, in words."""
    words, unit = LAWS[channel]
    return DIRECTIONS.get(law.direction or "", words), unit


def _quantity_words(law: LawCurve) -> tuple[str, str]:
    """What a law is drawn over and its unit, in words."""
    words, unit = QUANTITIES[law.quantity]
    return words, "share" if law.unit == "1" else unit


def _describe(diagnosis: DiagnosisDocument, part: ChannelRemainder, law: LawCurve) -> str:
    """The caption: how large the missing law is, and how it and the named one lie to each other."""
    (what, unit), (over, over_unit) = _words(part.channel, law), _quantity_words(law)
    x, y = np.array(law.x), np.array(law.y)
    if law.period_s:
        period = f"within each period of {format_number(law.period_s)} s"
        size = f"The model lacks {what} that swings in time by ± {format_number(np.ptp(y) / 2, 2)} {unit}, {period}."
    else:
        low, high = sorted((int(np.argmin(y)), int(np.argmax(y))), key=lambda k: x[k])
        at = [f"{format_number(y[k], 2)} {unit} at {format_number(x[k], 2)} {over_unit}" for k in (low, high)]
        size = f"The model lacks {what} that changes with the {over}, from {at[0]} to {at[1]}."
    band = "Orange: what free functions show, which know no effect, with a 95 % band."
    if law.named is None:
        return f"{size} {band} No effect is named."
    names = join_words([plain_name(f.effect) for f in diagnosis.findings]) or "what is named"
    inside = np.abs(np.array(law.named) - y) <= LIMITS.band_sd * np.array(law.sd)
    where = "throughout" if inside.all() else f"at {inside.sum()} of {len(y)} points"
    return f"{size} {band} Blue: what they would show if {names} were all that is missing, within the band {where}."


def _draw(channel: str, law: LawCurve, title: str) -> Markup:
    """The curve with its band, and the named law over it, as an SVG element called `title`."""
    figure, ax = create_panel(HEIGHT)
    x, y, half = np.array(law.x), np.array(law.y), LIMITS.band_sd * np.array(law.sd)
    ax.axhline(0.0, color=INK, lw=0.6)
    ax.fill_between(x, y - half, y + half, color=BEFORE, alpha=0.22, lw=0, label="95 % band")
    ax.plot(x, y, "o-", color=BEFORE, lw=1.6, ms=3.2, label="free functions")
    if law.named is not None:
        ax.plot(x, np.array(law.named), "--", color=AFTER, lw=2.0, label="named law")
    _frame(ax, y, half)
    what, unit = _words(channel, law)
    over, over_unit = _quantity_words(law)
    over = f"time within a period of {law.period_s:.3g} s" if law.period_s else over
    ax.set_ylabel(f"missing {what}\n({unit})".replace(" of the", "\nof the").replace(" along", "\nalong"))
    ax.set_xlabel(f"{over} ({over_unit})")
    add_legend_above(figure)
    return render_svg(figure, title)


def _frame(ax: Any, y: Floats, half: Floats) -> None:
    """Limit the frame of `ax` to the curve and most of its band, which may be wide where little was driven."""
    wide = float(np.quantile(half, 0.8))
    low, high = min(float(np.min(y)), 0.0) - wide, max(float(np.max(y)), 0.0) + wide
    ax.set_ylim(low - 0.05 * (high - low), high + 0.05 * (high - low))
