"""The panels by which Foxglove shows a view: the floor in 3D, plots of commands and motion, states, and what was found.

The file is what Foxglove itself exports as a layout (a panel's identifier is its type and a name); Lichtblick reads it
as well.
"""

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from bcid.view.content import ViewContent
from bcid.view.messages import FLOOR_FRAME
from bcid.view.scene import CAR_COLOURS, FRAMES
from bcid.view.vehicle_file import COMMAND_TOPIC

Panel = dict[str, Any]

HIDDEN_TOPICS = ("/bcid/push_map/before", "/bcid/push_map/after")
"""Topics that are offered, but not drawn until they are asked for: arrows of a whole take cover each other."""
TWIST_PARTS = {"v_x_mps": "v_x (m/s)", "v_y_mps": "v_y (m/s)", "yaw_rate_radps": "yaw rate (rad/s)"}
COMMAND_COLOURS = {"steering_rad": "#cc79a7", "throttle_mps": "#56b4e9"}
CAMERA_ANGLE_DEG, CAMERA_PER_FLOOR = 35.0, 1.2


def make_layout(content: ViewContent, topics: Sequence[str]) -> dict[str, Any]:
    """The layout for a view with these `topics`, as JSON."""
    plots = {f"Plot!{field}": _twist_plot(field, label, topics) for field, label in TWIST_PARTS.items()}
    panels = {
        "3D!floor": _floor_panel(content, topics),
        "Plot!commands": _plot("Commands", [
            _series(f"{COMMAND_TOPIC}.{field}", field, colour) for field, colour in COMMAND_COLOURS.items()
        ]),
        **plots,
        "StateTransitions!state": {
            "foxglovePanelTitle": "State", "isSynced": True,
            "paths": [
                {"value": f"/bcid/state.{field}", "label": field, "timestampMethod": "headerStamp"}
                for field in ("motion", "place", "contact")
            ],
        },
        "RosOut!findings": {
            "foxglovePanelTitle": "Findings", "searchTerms": [], "minLogLevel": 1, "topicToRender": "/bcid/findings"
        },
    }  # fmt: skip
    left = _split("column", "3D!floor", "RosOut!findings", 72)
    right = _stack(["Plot!commands", *plots, "StateTransitions!state"])
    return {
        "configById": panels, "globalVariables": {}, "userNodes": {}, "playbackConfig": {"speed": 1},
        "layout": _split("row", left, right, 58),
    }  # fmt: skip


def _split(direction: str, first: Any, second: Any, share: float) -> dict[str, Any]:
    """Two parts side by side ("row") or one above the other ("column"); the first takes `share` percent."""
    return {"direction": direction, "first": first, "second": second, "splitPercentage": share}


def _stack(panels: Sequence[str]) -> Any:
    """Panels one above the other, equally high."""
    first, *rest = panels
    return _split("column", first, _stack(rest), round(100.0 / len(panels), 2)) if rest else first


def _floor_panel(content: ViewContent, topics: Sequence[str]) -> Panel:
    """The floor seen from above at a slant, wide enough for the whole drive."""
    low, high = (edge(content.recording.poses.values[:, :2], axis=0) for edge in (np.min, np.max))
    x, y = (float(v) for v in 0.5 * (low + high))
    drawn: dict[str, Panel] = {
        topic: {"visible": topic not in HIDDEN_TOPICS}
        for topic in topics
        if topic in ("/bcid/floor", "/bcid/cars", "/bcid/velocity", "/bcid/places", "/bcid/pushes", *HIDDEN_TOPICS)
    }
    for topic in topics:
        part, _, kind = topic.removeprefix("/bcid/").partition("/")
        if kind == "path":
            drawn[topic] = {"visible": True, "type": "line", "lineWidth": 0.05, "gradient": [CAR_COLOURS[part]] * 2}
        elif kind == "pose":
            drawn[topic] = {"visible": False}
    return {
        "foxglovePanelTitle": "Floor", "followMode": "follow-none", "followTf": FLOOR_FRAME,
        "cameraState": {
            "perspective": True, "distance": round(CAMERA_PER_FLOOR * float(max(high - low)), 2),
            "phi": CAMERA_ANGLE_DEG, "thetaOffset": 0, "fovy": 45, "near": 0.01, "far": 5000, "target": [0, 0, 0],
            "targetOffset": [round(x, 2), round(y, 2), 0], "targetOrientation": [0, 0, 0, 1],
        },
        "scene": {"backgroundColor": "#202020", "transforms": {"visible": False}},
        "transforms": {f"frame:{frame}": {"visible": False} for frame in (FLOOR_FRAME, *FRAMES.values())},
        "topics": drawn, "layers": {},
    }  # fmt: skip


def _twist_plot(field: str, label: str, topics: Iterable[str]) -> Panel:
    """A plot of one component of the twist: as estimated, and as each model predicts it."""
    names = [topic.split("/")[2] for topic in topics if topic.endswith("/twist")]
    return _plot(label, [_series(f"/bcid/{name}/twist.{field}", name, CAR_COLOURS[name]) for name in names])


def _series(path: str, label: str, colour: str) -> Panel:
    """A line of a plot: the field of a topic, over the stamps of its messages."""
    return {
        "value": path, "label": label, "color": colour, "enabled": True, "timestampMethod": "headerStamp",
        "showLine": True, "lineSize": 1.2,
    }  # fmt: skip


def _plot(title: str, paths: Sequence[Panel]) -> Panel:
    """A plot over time, which zooms with the others."""
    return {
        "foxglovePanelTitle": title, "title": title, "paths": list(paths), "isSynced": True, "xAxisVal": "timestamp",
        "showLegend": True, "legendDisplay": "floating", "showXAxisLabels": True, "showYAxisLabels": True,
        "showPlotValuesInLegend": True, "sidebarDimension": 240,
    }  # fmt: skip
