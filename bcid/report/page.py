"""The page of a report and its figures, drawn from the report's content alone."""

import itertools
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from bcid.report.canvas import insert_gaps, render_data_uri
from bcid.report.content import PAPER_TABLE, ReportContent, build_report
from bcid.report.formats import SPAN_NAMES, format_number, format_thousandths
from bcid.report.limits import LIMITS
from bcid.report.templates import write_page

COLOURS = {
    "newton-euler": "#0072b2", "newton-euler-linear": "#999999", "narx-mlp": "#e69f00",
    "k-mlp": "#009e73", "k-sindy": "#cc79a7", "k-sindy-mlp": "#d55e00",
}  # fmt: skip
CHANNELS = (("v_x", "m/s"), ("v_y", "m/s"), ("yaw rate", "rad/s"))
# Lengths (s) of the excerpt whose paths are drawn, and of the states that are drawn at most.
EXCERPT_S, LONGEST_S = 40.0, 120.0
NOISE_UNITS = {
    "q_v_f": "m/s/√s", "q_beta_f": "rad/√s", "q_beta_r": "rad/√s", "q_delta": "rad/√s", "r_position": "m",
    "r_yaw": "rad", "r_steering": "rad", "r_yaw_rate": "rad/s", "r_wheel_speed": "m/s",
}  # fmt: skip


def write_report_page(content: ReportContent, path: Path) -> None:
    """Write the comparison of models to the HTML file `path`, with its figures and tables."""
    every, tuning = f"{content.restart_s:g} s", content.takes[0].estimate.tuning
    figures = (
        (
            "Trajectories",
            f"The {EXCERPT_S:g} s with the largest steering angles; predicted paths restart from the measured state "
            f"every {every} (crosses). Best model first.",
            draw_trajectories(content),
        ),
        (
            "Where the models differ",
            f"Error by steering angle, predictions restarted every {every}. "
            "The linearised model holds only near straight driving.",
            draw_error_over_steering(content),
        ),
        (
            "Closed-loop states",
            "All models driven by the take's commands alone from its first sample; black is the smoothed estimate. "
            "Shaded: the best model's 95 % interval. Curves that leave the frame are cut.",
            draw_states(content),
        ),
    )
    noise = [(name, f"{value:.3g} {NOISE_UNITS[name]}") for name, value in tuning.noise]
    write_page(
        path, "page.html.j2", {"number": format_number, "thousandths": format_thousandths}, content=content,
        table=build_report(content), paper=PAPER_TABLE, span_names=SPAN_NAMES,
        figures=figures, noise=noise + tuning.describe_steering(),
    )  # fmt: skip


def _model_colour(name: str) -> str:
    """Hexadecimal colour in which all figures draw the model called `name`; one for all unknown names."""
    return COLOURS.get(name, "#56b4e9")


def draw_trajectories(content: ReportContent) -> str:
    """Predicted paths over the measured one, a panel for each model, as the data URI of an image.

    Drawn are the EXCERPT_S seconds with the largest steering angles; predictions restart from the measured state
    every few seconds.
    """
    take = content.validation
    ranked = content.ranked_models()
    columns = min(3, len(ranked))
    rows = -(-len(ranked) // columns)
    shown = _hardest_rows(content)
    x, y = take.pose[shown, 0], take.pose[shown, 1]
    height = 0.6 + rows * (11.0 / columns) * (np.ptp(y) + 1.2) / (np.ptp(x) + 1.2)
    figure = Figure(figsize=(11, height), layout="constrained")
    axes = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    for ax, model in zip(axes.flat, ranked, strict=False):
        segments = np.flatnonzero(np.diff(take.segment[shown])) + 1
        ax.plot(*insert_gaps(take.pose[shown, :2], segments).T, color="black", lw=1.0, label="measured")
        starts = np.flatnonzero(model.restart[shown])
        path = insert_gaps(model.restart_pose[shown, :2], starts)
        ax.plot(*path.T, color=_model_colour(model.name), lw=1.6, label="predicted")
        ax.plot(x[starts], y[starts], "x", color="black", ms=5, label="restarted")
        ax.set_title(model.name, fontsize=10)
        ax.set_aspect("equal")
        ax.set_xlim(x.min() - 0.6, x.max() + 0.6)
        ax.set_ylim(y.min() - 0.6, y.max() + 0.6)
    for ax in axes.flat[len(ranked) :]:
        ax.axis("off")
    axes[0, 0].legend(fontsize=8, loc="upper right")
    figure.supxlabel("x (m)", fontsize=9)
    figure.supylabel("y (m)", fontsize=9)
    return render_data_uri(figure)


def _hardest_rows(content: ReportContent) -> slice:
    """Rows of the EXCERPT_S seconds of the validation take, from a restart on, with the largest sum of |delta|."""
    take = content.validation
    size = round(EXCERPT_S / take.period_s)
    starts = np.flatnonzero(content.models[0].restart)
    turning = np.r_[0.0, np.cumsum(np.abs(take.kinematic[:, 3]))]
    gains = [turning[min(k + size, len(take))] - turning[k] for k in starts]
    first = int(starts[int(np.argmax(gains))])
    return slice(first, min(first + size, len(take)))


def draw_states(content: ReportContent) -> str:
    """Predicted v_x, v_y and yaw rate of all models over the measured ones, as the data URI of an image.

    Predictions run in closed loop from the validation take's first sample; drawn are its first LONGEST_S seconds,
    with the 95 % interval of the model of least NMSE.
    """
    take = content.validation
    shown = take.time_s <= take.time_s[0] + LONGEST_S
    figure = Figure(figsize=(11, 7.5), layout="constrained")
    axes = figure.subplots(3, 1, sharex=True)
    for c, (ax, (name, unit)) in enumerate(zip(axes, CHANNELS, strict=True)):
        for model in reversed(content.ranked_models()):
            ax.plot(
                take.time_s[shown], model.twist[shown, c], color=_model_colour(model.name), lw=0.9, label=model.name
            )
        best = content.ranked_models()[0]
        band = (best.twist[shown, c] - best.half[shown, c], best.twist[shown, c] + best.half[shown, c])
        ax.fill_between(take.time_s[shown], *band, color=_model_colour(best.name), alpha=0.2, lw=0.0)
        measured = take.twist[shown, c]
        ax.plot(take.time_s[shown], measured, color="black", lw=1.4, label="measured (smoothed)")
        room = 0.35 * float(np.ptp(measured)) + 1e-6
        ax.set_ylim(measured.min() - room, measured.max() + room)
        ax.set_ylabel(f"{name} ({unit})")
    axes[0].legend(fontsize=8, ncols=4, loc="lower center", bbox_to_anchor=(0.5, 1.0), frameon=False)
    axes[-1].set_xlabel("time (s)")
    return render_data_uri(figure)


def draw_error_over_steering(content: ReportContent) -> str:
    """RMS prediction error of each model in bins of the steering angle |delta|, as the data URI of an image.

    The error is that of the twist (v_x, v_y, yaw rate), each channel divided by its standard deviation in the
    training data; predictions restart from the measured state every few seconds.
    """
    take = content.validation
    angle = np.abs(take.kinematic[:, 3])
    edges = np.linspace(0.0, max(float(angle.max()), 1e-3), 9)
    weights = np.array(content.models[0].evaluation.weights)
    figure = Figure(figsize=(8, 4), layout="constrained")
    ax = figure.subplots()
    for model in content.ranked_models():
        squares = ((weights * (model.restart_twist - take.twist)) ** 2).mean(axis=1)
        rows = [(angle >= a) & (angle <= b) for a, b in itertools.pairwise(edges)]
        rms = [float(np.sqrt(squares[r].mean())) if r.sum() >= LIMITS.min_rows_per_bin else np.nan for r in rows]
        ax.plot(0.5 * (edges[1:] + edges[:-1]), rms, "o-", ms=4, color=_model_colour(model.name), label=model.name)
    ax.set_yscale("log")
    ax.set_xlabel("steering angle |δ| (rad)")
    ax.set_ylabel("RMS of W (predicted − measured)")
    ax.grid(alpha=0.3, which="both")
    ax.legend(fontsize=8, ncols=2)
    return render_data_uri(figure)
