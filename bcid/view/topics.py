"""The topics of a view, and their messages in the order of time."""

from collections.abc import Iterator, Mapping
from typing import NamedTuple

import numpy as np

from bcid.aliases import Floats
from bcid.evaluation.closed_loop import RestartedPrediction
from bcid.likelihood.take import KNOT_S
from bcid.recording.checks.contacts import find_contacts
from bcid.recording.types import BRAKE_CHANNEL
from bcid.view import messages, scene
from bcid.view.content import ViewContent
from bcid.view.findings import logged_texts
from bcid.view.messages import Message
from bcid.view.vehicle_file import COMMAND_TOPIC, POSE_TOPIC

TWIST_FIELDS = ("v_x_mps", "v_y_mps", "yaw_rate_radps")
STANDING_MPS, STANDING_RADPS = 0.02, 0.02
"""A car that is slower than both stands still."""


class Timed(NamedTuple):
    """A message and its stamp (ns)."""

    stamp_ns: int
    message: Message


class Topic(NamedTuple):
    """A topic with the type of its messages, in the order of time."""

    name: str
    schema: str
    messages: list[Timed]


def list_topics(content: ViewContent) -> list[Topic]:
    """All topics of a view that have messages."""
    topics = [
        Topic("/tf", "foxglove.FrameTransform", list(_transforms(content))),
        Topic(POSE_TOPIC, "foxglove.PoseInFrame", list(_measured_poses(content))),
        Topic("/bcid/measured/twist", "bcid.Twist", _twists(content, content.estimate.twist)),
        _command_topic(content),
        *_channel_topics(content),
        *(t for name, p in content.predictions.items() for t in _prediction_topics(content, name, p)),
        Topic("/bcid/floor", "foxglove.SceneUpdate", [_floor(content)]),
        Topic("/bcid/cars", "foxglove.SceneUpdate", [_cars(content)]),
        Topic("/bcid/velocity", "foxglove.SceneUpdate", list(_velocities(content))),
        Topic("/bcid/state", "bcid.State", list(_states(content))),
        Topic("/bcid/findings", "foxglove.Log", list(_logs(content))),
        *_diagnosis_topics(content),
    ]
    return [topic for topic in topics if topic.messages]


def _begin_ns(content: ViewContent) -> int:
    """The stamp (ns) of the first pose, at which all that stays in place is drawn."""
    return content.stamp_ns(float(content.recording.poses.time_s[0]))


def _stamped_rows(content: ViewContent, time_s: Floats, rows: Floats) -> Iterator[tuple[int, Floats]]:
    """Stamps (ns) and rows of a table (N, n) at the times (N,) of the recording, without rows that are not finite."""
    for t, row in zip(time_s.tolist(), rows, strict=True):
        if np.isfinite(row).all():
            yield content.stamp_ns(t), row


def _measured_poses(content: ViewContent) -> Iterator[Timed]:
    """The measured poses, each at its own stamp."""
    poses = content.recording.poses
    for ns, pose in _stamped_rows(content, poses.time_s, poses.values):
        yield Timed(ns, messages.pose_in_frame(ns, pose))


def _transforms(content: ViewContent) -> Iterator[Timed]:
    """Where each car's frame stands: the measured one at the poses' stamps, the predicted ones on the grid."""
    poses, grid_s = content.recording.poses, content.estimate.time_s
    tables = {"measured": (poses.time_s, poses.values)}
    tables |= {name: (grid_s, p.pose) for name, p in content.predictions.items()}
    timed = [
        Timed(ns, messages.frame_transform(ns, scene.FRAMES[name], pose))
        for name, (time_s, rows) in tables.items()
        for ns, pose in _stamped_rows(content, time_s, rows)
    ]
    return iter(sorted(timed, key=lambda t: t.stamp_ns))


def _twists(content: ViewContent, twist: Floats) -> list[Timed]:
    """Twists (K, 3) on the grid of the estimate as messages."""
    rows = _stamped_rows(content, content.estimate.time_s, twist)
    return [Timed(ns, messages.numbers_message(ns, TWIST_FIELDS, row.tolist())) for ns, row in rows]


def _command_topic(content: ViewContent) -> Topic:
    """The commands at their own stamps, with the brake where it was a channel of its own."""
    recording = content.recording
    braked = BRAKE_CHANNEL in recording.channels
    stream = recording.driven if braked else recording.commands
    names = ("steering_rad", "throttle_mps", BRAKE_CHANNEL)[: stream.values.shape[1]]
    rows = _stamped_rows(content, stream.time_s, stream.values)
    timed = [Timed(ns, messages.numbers_message(ns, names, row.tolist())) for ns, row in rows]
    return Topic(COMMAND_TOPIC, "bcid.BrakedCommand" if braked else "bcid.Command", timed)


def _channel_topics(content: ViewContent) -> Iterator[Topic]:
    """A topic for every further channel of the recording, such as a measured wheel speed."""
    for name, stream in content.recording.channels.items():
        rows = _stamped_rows(content, stream.time_s, stream.values)
        timed = [Timed(ns, messages.numbers_message(ns, ["value"], row.tolist())) for ns, row in rows]
        yield Topic(f"/bcid/channels/{name}", "bcid.Channel", timed)


def _prediction_topics(content: ViewContent, name: str, predicted: RestartedPrediction) -> Iterator[Topic]:
    """Poses, twists and paths of a model's predictions; a path is told whole where its prediction starts."""
    grid_s = content.estimate.time_s
    rows = _stamped_rows(content, grid_s, predicted.pose)
    poses = [Timed(ns, messages.pose_in_frame(ns, pose)) for ns, pose in rows]
    yield Topic(f"/bcid/{name}/pose", "foxglove.PoseInFrame", poses)
    yield Topic(f"/bcid/{name}/twist", "bcid.Twist", _twists(content, predicted.twist))
    starts = np.flatnonzero(predicted.start)
    paths = []
    for begin, end in zip(starts, [*starts[1:], len(grid_s)], strict=True):
        ns, path = content.stamp_ns(float(grid_s[begin])), predicted.pose[begin:end]
        paths.append(Timed(ns, messages.poses_in_frame(ns, path[np.isfinite(path).all(axis=1)])))
    yield Topic(f"/bcid/{name}/path", "foxglove.PosesInFrame", paths)


def _floor(content: ViewContent) -> Timed:
    """The floor with the path of the drive."""
    ns = _begin_ns(content)
    return Timed(ns, messages.scene_update(scene.floor_entity(ns, content.vehicle, content.recording.poses.values)))


def _cars(content: ViewContent) -> Timed:
    """The measured car and the predicted ones, which move with their frames."""
    ns = _begin_ns(content)
    return Timed(ns, messages.scene_update(
        *(scene.car_entity(ns, name, content.vehicle) for name in ("measured", *content.predictions))
    ))  # fmt: skip


def _velocities(content: ViewContent) -> Iterator[Timed]:
    """The estimated velocity as an arrow at the car."""
    e = content.estimate
    for ns, row in _stamped_rows(content, e.time_s, np.hstack([e.pose, e.twist])):
        yield Timed(ns, messages.scene_update(scene.velocity_entity(ns, content.vehicle, row[:3], row[3:])))


def _states(content: ViewContent) -> Iterator[Timed]:
    """What the car does and where, whenever that changes, and at the end of the take."""
    e, first_s = content.estimate, float(content.recording.poses.time_s[0])
    places = scene.located_places(content.diagnosed.document) if content.diagnosed else {}
    contacts = find_contacts(content.recording)
    said: Mapping[str, object] = {}
    for k, t in enumerate(e.time_s.tolist()):
        x, y = e.pose[k, :2]
        inside = [n for n, c in places.items() if np.hypot(x - c.x_m, y - c.y_m) <= c.radius_m]
        bumps = [c.kind for c in contacts if c.begin_s <= t - first_s <= c.end_s]
        state = {
            "motion": _motion(e.twist[k]), "segment": int(e.segment[k]), "place": ", ".join(inside) or "elsewhere",
            "contact": ", ".join(bumps) or "none",
        }  # fmt: skip
        if state != said or k == len(e) - 1:
            ns = content.stamp_ns(t)
            yield Timed(ns, {"timestamp": messages.stamp_message(ns), **state})
        said = state


def _motion(twist: Floats) -> str:
    """Whether a car with a twist (3,) drives forward or backward, or stands."""
    if np.hypot(twist[0], twist[1]) < STANDING_MPS and abs(twist[2]) < STANDING_RADPS:
        return "standing"
    return "forward" if twist[0] >= 0.0 else "backward"


def _logs(content: ViewContent) -> Iterator[Timed]:
    """What is told of the take, each text at its time."""
    for text in logged_texts(content):
        ns = content.stamp_ns(text.time_s)
        yield Timed(ns, messages.log_message(ns, text.text, text.subject, text.level))


def _diagnosis_topics(content: ViewContent) -> Iterator[Topic]:
    """The places located, and the pushes that explain what the model lacks; nothing without a diagnosis."""
    if content.diagnosed is None:
        return
    begin, knots = _begin_ns(content), content.diagnosed.knots
    places = scene.located_places(content.diagnosed.document)
    circles = [scene.place_entity(begin, name, circle, content.vehicle) for name, circle in places.items()]
    if circles:
        yield Topic("/bcid/places", "foxglove.SceneUpdate", [Timed(begin, messages.scene_update(*circles))])
    scale, timed = scene.PushScale(knots, content.vehicle), []
    for k, middle_s in enumerate(knots["time_s"].tolist()):
        ns = content.stamp_ns(middle_s - 0.5 * KNOT_S)
        timed.append(Timed(ns, messages.scene_update(*scene.push_entities(ns, knots, k, scale))))
    yield Topic("/bcid/pushes", "foxglove.SceneUpdate", timed)
    for stage in scene.STAGES:
        drawn = scene.push_map_entity(begin, stage, knots, scale)
        yield Topic(f"/bcid/push_map/{stage}", "foxglove.SceneUpdate", [Timed(begin, messages.scene_update(drawn))])
