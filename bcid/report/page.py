"""The page of a report, from the report's content alone."""

from pathlib import Path

from bcid.report.content import ReportContent, build_report
from bcid.report.formats import SPAN_NAMES, format_number, format_thousandths
from bcid.report.model_figures import draw_model_pictures
from bcid.report.templates import write_page

NOISE_UNITS = {
    "q_v_f": "m/s/√s", "q_beta_f": "rad/√s", "q_beta_r": "rad/√s", "q_delta": "rad/√s", "r_position": "m",
    "r_yaw": "rad", "r_steering": "rad", "r_yaw_rate": "rad/s", "r_wheel_speed": "m/s",
}  # fmt: skip


def write_report_page(content: ReportContent, path: Path) -> None:
    """Write the comparison of models to the HTML file `path`, with its figures and tables."""
    tuning = content.takes[0].estimate.tuning
    noise = [(name, f"{value:.3g} {NOISE_UNITS[name]}") for name, value in tuning.noise]
    write_page(
        path, "page.html.j2", {"number": format_number, "thousandths": format_thousandths}, content=content,
        span_names=SPAN_NAMES, table=build_report(content), comparison_pictures=draw_model_pictures(content),
        noise=noise + tuning.describe_steering(),
    )  # fmt: skip
