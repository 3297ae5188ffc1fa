"""One offline HTML page: jinja2 with everything escaped, figures embedded, no script, no outside resource."""

from __future__ import annotations

from pathlib import Path

from bcid import __version__
from bcid.report.content import PAPER_TABLE, Content, report_json
from bcid.report.estimate_words import lost_car, steering_lines
from bcid.report.figures import all_figures
from bcid.report.templates import template


def _number(value: float | None, digits: int = 3) -> str:
    return "–" if value is None else f"{value:.{digits}g}"


def _thousandths(value: float | None) -> str:
    """An NMSE as multiples of 10^-3."""
    return "–" if value is None else (f"{1e3 * value:.2f}" if value < 1 else f"{1e3 * value:.3g}")


def write_page(content: Content, path: Path) -> None:
    """Write the comparison to `path`."""
    text = template("page.html.j2", number=_number, thousandths=_thousandths, lost_car=lost_car).render(
        version=__version__,
        content=content,
        table=report_json(content),
        paper=PAPER_TABLE,
        figures=all_figures(content),
        noise=_noise_lines(content),
    )
    path.write_text(text, encoding="utf-8")


def _noise_lines(content: Content) -> list[tuple[str, str]]:
    """The estimator's constants, and how they came about."""
    facts = content.takes[0].estimate["facts"]
    units = {
        "q_v_f": "m/s/√s", "q_beta_f": "rad/√s", "q_beta_r": "rad/√s", "q_delta": "rad/√s", "r_position": "m",
        "r_yaw": "rad", "r_steering": "rad", "r_yaw_rate": "rad/s", "r_wheel_speed": "m/s",
    }  # fmt: skip
    lines = [(name, f"{value:.3g} {units[name]}") for name, value in facts["noise"].items()]
    return lines + steering_lines(facts)
