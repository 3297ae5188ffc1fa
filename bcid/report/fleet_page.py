"""The page of a fleet: what all logs say together, a strip for each parameter over days, a line for each log."""

from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup

from bcid.aliases import Floats
from bcid.documents.fleet import FleetDocument, FleetParameter
from bcid.report.canvas import AFTER, BEFORE, INK, MUTED, TEXT_SIZE, Picture, create_panel, render_svg
from bcid.report.fleet_words import fleet_sentences, name_of_parameter
from bcid.report.formats import format_number, plain_name, unit_text
from bcid.report.templates import write_page

STRIP_HEIGHT = 1.5  # inches
DAY_WIDTH = 0.8
"""Share of a day's width over which its logs are spread."""


def write_fleet_page(document: FleetDocument, path: Path) -> None:
    """Write what the logs of a fleet say, one by one and together, to the HTML file `path`."""
    write_page(
        path, "fleet.html.j2", {"number": format_number, "plain": plain_name}, fleet=document,
        sentences=fleet_sentences(document), strips=draw_strips(document), presence=draw_presence(document),
    )  # fmt: skip


def draw_strips(document: FleetDocument) -> Picture | None:
    """A strip for each parameter: its logs with 95 % intervals, day by day, and the mean of each day; None without."""
    together = document.together
    if together is None or not together.parameters:
        return None
    moved = {(m.symbol, m.day) for m in together.moved}
    panels = tuple(_draw_strip(p, together.days, moved) for p in together.parameters)
    caption = (
        "Points: each log by itself, with its 95 % interval. Lines: the mean of a day with its 95 % interval; orange "
        "where it is another than on the first day that has one."
    )
    return Picture("Parameters over days", caption, panels)


def _draw_strip(parameter: FleetParameter, days: tuple[str, ...], moved: set[tuple[str, str]]) -> Markup:
    """One parameter over the days, as an SVG element."""
    title = name_of_parameter(parameter.symbol)
    figure, ax = create_panel(STRIP_HEIGHT, f"{title} ({unit_text(parameter.unit)})".replace(" ()", ""))
    for k, day in enumerate(days):
        own = [log for log in parameter.logs if log.day == day]
        at, values, half = _spread(k, len(own)), [log.value for log in own], [1.96 * log.se for log in own]
        ax.errorbar(at, values, yerr=half, fmt="o", ms=3.0, color=MUTED, lw=0.8)
    for mean in parameter.days:
        k = days.index(mean.day)
        colour = BEFORE if (parameter.symbol, mean.day) in moved else AFTER
        side = k - DAY_WIDTH / 2, k + DAY_WIDTH / 2
        ax.fill_between(side, *mean.ci95, color=colour, alpha=0.22, lw=0)
        ax.plot(side, (mean.mean, mean.mean), color=colour, lw=1.8)
    _name_days(ax, days)
    return render_svg(figure, f"{title} over days")


def draw_presence(document: FleetDocument) -> Picture | None:
    """For each effect of the fleet the probability that each log has it, in the order of days; None without any."""
    together = document.together
    if together is None or not together.effects:
        return None
    panels = []
    for effect in together.effects:
        title = f"{plain_name(effect.effect)}: probability in each log"
        figure, ax = create_panel(STRIP_HEIGHT, title)
        by_day = [
            [log for log in document.logs if log.day == day and log.name in effect.in_logs] for day in together.days
        ]
        width = 0.6 * DAY_WIDTH / max(1, *map(len, by_day))
        for k, logs in enumerate(by_day):
            ax.bar(_spread(k, len(logs)), [effect.in_logs[log.name] for log in logs], width=width, color=AFTER)
        ax.set_ylim(0.0, 1.0)
        _name_days(ax, together.days)
        panels.append(render_svg(figure, title))
    return Picture("Effects log by log", "Bars: how certain it is that a log has the effect.", tuple(panels))


def _spread(day: int, count: int) -> Floats:
    """Where the logs of a day are drawn, side by side."""
    return np.asarray(day + DAY_WIDTH * ((np.arange(count) + 0.5) / max(count, 1) - 0.5))


def _name_days(ax: Any, days: tuple[str, ...]) -> None:
    """Write the days below an axis, of many only some."""
    step = max(1, len(days) // 6)
    shown = range(0, len(days), step)
    ax.set_xticks(list(shown), [days[k] or "day unknown" for k in shown], fontsize=TEXT_SIZE - 1.5, color=INK)
    ax.set_xlim(-0.6, len(days) - 0.4)
