"""The pose one period later, from the twists before and after it: the rule by which predictions are scored, traced."""

from __future__ import annotations

import numpy as np

from bcid.evaluation.closed_loop import integrate_poses
from bcid.export.formulas import POSE, TWIST
from bcid.export.graph import Graph, Node


def trace_pose(period_s: float) -> tuple[Node, ...]:
    """The pose [p_x, p_y, theta] after `period_s` (s); inputs are called as in `POSE` and `TWIST`, then `*_next`."""
    graph = Graph()
    pose = np.array([graph.input(quantity.name) for quantity in POSE], object)
    twists = [[graph.input(quantity.name + later) for quantity in TWIST] for later in ("", "_next")]
    return tuple(graph.as_node(number) for number in integrate_poses(pose, np.array(twists, object), period_s)[1])
