"""Shapes of a view: the floor, the place located, cars, the velocity, and pushes as arrows."""

from collections.abc import Mapping

import numpy as np

from bcid.aliases import Floats
from bcid.documents.diagnosis import Circle, DiagnosisDocument
from bcid.likelihood.take import KNOT_S
from bcid.vehicle import Vehicle
from bcid.view import messages
from bcid.view.messages import Colour, Message, parse_colour, pose_message, vector_message

CAR_COLOURS = {"measured": "#f0f0f0", "predicted": "#e69f00", "before": "#d55e00", "after": "#0072b2"}
"""Colours of what was measured and of what models predict, by name: those of the report."""
FRAMES = {"measured": "car", "predicted": "car_predicted", "before": "car_before", "after": "car_after"}
"""The coordinate frames of the cars."""
STAGES = ("before", "after")

FLOOR_COLOUR, PATH_COLOUR, PLACE_COLOUR = parse_colour("#404040", 0.6), parse_colour("#808080"), "#f0e442"
BODY_OPACITY, GHOST_OPACITY = 0.9, 0.45
BODY_PER_WHEELBASE, WIDTH_PER_WHEELBASE, HEIGHT_PER_WHEELBASE = 1.4, 0.6, 0.3
"""The body that is drawn, by the wheelbase: no vehicle file says how large it is."""
WHEEL_PER_WHEELBASE = 0.28
AHEAD_S = 0.5
"""The velocity's arrow ends where the car would be after this time (s)."""
PUSH_PER_WHEELBASE, USUAL_PUSH_QUANTILE = 1.5, 0.95
"""The arrow of a push that 5 % exceed, by the wheelbase."""
LARGEST_SHARE = 0.2
"""The least share of the largest push that counts as usual: where a model lacks next to nothing, one push is all."""
MARGIN_WHEELBASES, FLOOR_THICKNESS_M = 2.0, 0.01


def floor_entity(ns: int, vehicle: Vehicle, poses: Floats) -> Message:
    """The floor as far as it was driven over by poses (N, 3), with the whole path of the drive on it."""
    margin = MARGIN_WHEELBASES * vehicle.body.wheelbase_m
    low, high = poses[:, :2].min(axis=0) - margin, poses[:, :2].max(axis=0) + margin
    (x, y), (length, width) = 0.5 * (low + high), high - low
    below = pose_message(x, y, 0.0, -0.5 * FLOOR_THICKNESS_M)
    slab = messages.cube_message(below, vector_message(length, width, FLOOR_THICKNESS_M), FLOOR_COLOUR)
    return messages.scene_entity(
        ns, "floor", cubes=[slab], lines=[messages.line_message(poses[:, :2], PATH_COLOUR, 1.0, z=FLOOR_THICKNESS_M)]
    )


def car_entity(ns: int, name: str, vehicle: Vehicle) -> Message:
    """A car called `name` in its own frame: body, wheels, and an arrow that points forward."""
    body, L = vehicle.body, vehicle.body.wheelbase_m
    colour = parse_colour(CAR_COLOURS[name], BODY_OPACITY if name == "measured" else GHOST_OPACITY)
    width, height, wheel = (
        body.rear_track_m or WIDTH_PER_WHEELBASE * L,
        HEIGHT_PER_WHEELBASE * L,
        WHEEL_PER_WHEELBASE * L,
    )
    middle = 0.5 * (body.cog_to_front_m - body.cog_to_rear_m)
    box = vector_message(BODY_PER_WHEELBASE * L, width, height)
    tyre, black = vector_message(wheel, 0.3 * wheel, wheel), Colour(0.1, 0.1, 0.1, colour.a)
    wheels = [
        messages.cube_message(pose_message(x, y, 0.0, 0.5 * wheel), tyre, black)
        for x in (body.cog_to_front_m, -body.cog_to_rear_m)
        for y in (-0.5 * width, 0.5 * width)
    ]
    nose = messages.arrow_message(
        vector_message(0.0, 0.0, wheel + height), messages.yaw_message(0.0), 0.5 * BODY_PER_WHEELBASE * L + middle,
        0.08 * L, colour,
    )  # fmt: skip
    cubes = [messages.cube_message(pose_message(middle, 0.0, 0.0, 0.5 * (wheel + height)), box, colour), *wheels]
    return messages.scene_entity(ns, name, FRAMES[name], cubes=cubes, arrows=[nose])


def velocity_entity(ns: int, vehicle: Vehicle, pose: Floats, twist: Floats) -> Message:
    """The velocity of the CoG at a pose (3,) with a twist (3,), as an arrow AHEAD_S seconds long; none at rest."""
    L, speed = vehicle.body.wheelbase_m, float(np.hypot(twist[0], twist[1]))
    x, y, yaw = pose.tolist()
    turn = messages.yaw_message(yaw + float(np.arctan2(twist[1], twist[0])))
    tail = vector_message(x, y, (HEIGHT_PER_WHEELBASE + WHEEL_PER_WHEELBASE) * L)
    length, colour = AHEAD_S * speed, parse_colour("#009e73")
    arrows = [messages.arrow_message(tail, turn, length, 0.06 * L, colour)] if length > 0.02 * L else []
    return messages.scene_entity(ns, "velocity", arrows=arrows)


def located_places(document: DiagnosisDocument) -> dict[str, Circle]:
    """Circles on the floor where something acts, by what is there: named effects, or the place that was located."""
    named = {
        finding.effect: Circle(x_m=x, y_m=y, radius_m=radius)
        for finding in document.findings
        for x, y, radius in [[q and q.value for q in map(finding.parameters.get, ("x", "y", "radius"))]]
        if x is not None and y is not None and radius is not None
    }
    if named or document.where.place is None:
        return named
    return {"located": document.where.place}


def place_entity(ns: int, name: str, circle: Circle, vehicle: Vehicle) -> Message:
    """A circle on the floor as a flat cylinder with its name."""
    L = vehicle.body.wheelbase_m
    around = np.linspace(0.0, 2.0 * np.pi, 72, endpoint=False)
    rim = np.array([circle.x_m, circle.y_m]) + circle.radius_m * np.column_stack([np.cos(around), np.sin(around)])
    colour = parse_colour(PLACE_COLOUR)
    disc = messages.cylinder_message(
        pose_message(circle.x_m, circle.y_m, 0.0, FLOOR_THICKNESS_M), 2.0 * circle.radius_m, FLOOR_THICKNESS_M,
        parse_colour(PLACE_COLOUR, 0.2),
    )  # fmt: skip
    line = messages.line_message(rim, colour, 2.0, messages.LINE_LOOP, 2.0 * FLOOR_THICKNESS_M)
    text = messages.text_message(
        circle.x_m, circle.y_m + circle.radius_m, 0.5 * L, 0.2 * L, colour, name.replace("_", " ")
    )
    return messages.scene_entity(ns, name, cylinders=[disc], lines=[line], texts=[text])


class PushScale:
    """Lengths of arrows that stand for accelerations: m per m/s² on the floor, and m per rad/s² upward.

    An arrow that 5 % of the take's pushes exceed is one and a half wheelbases long, in either scale, or shorter if the
    longest would have more than five times that length.
    """

    def __init__(self, knots: Mapping[str, Floats], vehicle: Vehicle) -> None:
        """Scales for the pushes before anything is named, of the columns `knots`."""
        self.wheelbase_m = vehicle.body.wheelbase_m
        planar, turning = np.hypot(knots["before_fx"], knots["before_fy"]), np.abs(knots["before_mz"])
        length = PUSH_PER_WHEELBASE * self.wheelbase_m
        self.m_per_mps2, self.m_per_radps2 = (
            length / max(float(np.quantile(size, USUAL_PUSH_QUANTILE)), LARGEST_SHARE * float(size.max()), 1e-9)
            for size in (planar, turning)
        )

    def arrows(self, knots: Mapping[str, Floats], k: int, stage: str, opacity: float = 1.0) -> list[Message]:
        """The push at knot `k` that the model lacks in a `stage`: an arrow on the floor, and its moment upward.

        A moment that turns the car to the left points up (right-hand rule), one to the right down from above.
        """
        L, colour = self.wheelbase_m, parse_colour(CAR_COLOURS[stage], opacity)
        f_x, f_y, m_z = (float(knots[f"{stage}_{channel}"][k]) for channel in ("fx", "fy", "mz"))
        x, y, yaw = (float(knots[name][k]) for name in ("x", "y", "heading"))
        height = (HEIGHT_PER_WHEELBASE + WHEEL_PER_WHEELBASE + (0.1 if stage == "after" else 0.2)) * L
        length, moment = self.m_per_mps2 * float(np.hypot(f_x, f_y)), self.m_per_radps2 * abs(m_z)
        turn = messages.yaw_message(yaw + float(np.arctan2(f_y, f_x)))
        tail = vector_message(x, y, height if m_z >= 0.0 else height + moment)
        upward = messages.UPRIGHT if m_z >= 0.0 else messages.DOWNRIGHT
        arrows = [
            (length, messages.arrow_message(vector_message(x, y, height), turn, length, 0.08 * L, colour)),
            (moment, messages.arrow_message(tail, upward, moment, 0.05 * L, colour)),
        ]
        return [arrow for size, arrow in arrows if size > 0.01 * L]


def push_entities(ns: int, knots: Mapping[str, Floats], k: int, scale: PushScale) -> list[Message]:
    """The pushes of one knot before and after effects are named; they vanish when the knot is over."""
    lifetime = round(KNOT_S * 1e9)
    return [
        messages.scene_entity(ns, f"push {stage}", lifetime_ns=lifetime, arrows=scale.arrows(knots, k, stage))
        for stage in STAGES
    ]


def push_map_entity(ns: int, stage: str, knots: Mapping[str, Floats], scale: PushScale) -> Message:
    """The pushes of all knots at once, where on the floor each was."""
    arrows = [arrow for k in range(len(knots["time_s"])) for arrow in scale.arrows(knots, k, stage, GHOST_OPACITY)]
    return messages.scene_entity(ns, f"pushes {stage}", arrows=arrows)
