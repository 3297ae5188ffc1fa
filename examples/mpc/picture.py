"""The picture of docs/mpc.md: a panel for each model, with all tracks of the car's centre and its body now and then."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import scene

EVERY_S = 1.0
"""How often (s) the body of the first drive is drawn."""
BODY = ((0.89, 0.30), (0.89, -0.30), (-0.68, -0.30), (-0.68, 0.30))
"""Corners (m) of what is drawn as a body."""


def _place(points: Any, pose: Any) -> np.ndarray:
    """Points (K, 2) of the body frame in the world of a car at `pose` (3,)."""
    c, s = math.cos(pose[2]), math.sin(pose[2])
    return np.asarray(points) @ np.array([[c, s], [-s, c]]) + np.asarray(pose[:2])


def draw_drives(found: dict[str, Any], path: Path) -> None:
    """Draw the drives of mpc.json as a PNG at `path`."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    names = list(found["summary"])
    figure, panels = plt.subplots(1, len(names), figsize=(10.5, 4.4), sharey=True, layout="constrained")
    for panel, name in zip(panels, names, strict=True):
        drives = [d for d in found["drives"] if d["model"] == name]
        for d in drives:
            track = np.array(d["track"])
            panel.plot(track[:, 0], track[:, 1], lw=0.8, color="tab:blue" if d["parked"] else "tab:red", alpha=0.6)
        track = np.array(drives[0]["track"])
        step = round(EVERY_S / 0.1)
        for row in track[::step]:
            # where the wheel stands beyond a right angle, the car is pulled backward
            colour = "tab:orange" if abs(row[3]) > 0.5 * math.pi else "0.6"
            panel.add_patch(plt.Polygon(_place(BODY, row), fill=False, lw=0.8, ec=colour))
        panel.add_patch(plt.Polygon(_place(BODY, scene.GOAL), fill=False, lw=1.6, ls="--", ec="black"))
        for x, y, r in scene.PILLARS:
            panel.add_patch(plt.Circle((x, y), r, color="0.4"))
        panel.axvline(scene.WALLS[1], color="0.2", lw=2.5)
        panel.axhline(scene.WALLS[3], color="0.2", lw=2.5)
        s = found["summary"][name]
        panel.set_title(f"{name}: {s['parked']} of {s['drives']} parked", fontsize=10)
        panel.set_xlabel("x (m)")
        panel.set_aspect("equal")
        panel.set_xlim(2.3, 6.1)
        panel.set_ylim(-0.8, 3.6)
    panels[0].set_ylabel("y (m)")
    figure.savefig(path, dpi=100)
    plt.close(figure)
