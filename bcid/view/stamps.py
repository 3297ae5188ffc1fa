"""When a recording's time zero was, by the stamps in its file: so that a view has the times of all else recorded."""

from pathlib import Path

from bcid.recording.cuts import without_cut
from bcid.recording.formats.detect import detect_format
from bcid.recording.formats.mcap_contents import read_contents
from bcid.recording.formats.mcap_poses import read_pose_track
from bcid.recording.formats.transforms import STATIC_TOPIC
from bcid.recording.types import Recording
from bcid.vehicle import Vehicle
from bcid.view.content import earliest_zero_ns


def zero_stamp_ns(named: Path, vehicle: Vehicle, recording: Recording, allow_partial: bool = False) -> int:
    """The stamp (ns) from which the times of `recording` count, which was read from the file `named` or is a cut of it.

    Of an MCAP file it is the stamp of the first pose, or its log time where the recording's times are log times.  Other
    files have no date: their times count from 0, or from the whole second that keeps all of them above it.
    """
    path = without_cut(named)
    if detect_format(path) != "mcap" or vehicle.topics is None:
        return earliest_zero_ns(recording)
    topic = vehicle.topics.pose
    contents = read_contents(path, (topic, STATIC_TOPIC), allow_partial)
    schema = contents.schema_name(contents.published_channels(topic)[0].schema_id)
    track = read_pose_track(contents, schema, vehicle, vehicle.topics)
    # the reader notes it wherever log times stand for the stamps
    logged = any(odd.kind == "time base" for odd in recording.irregularities)
    stamps = [ns for ns in track.stamp_ns if ns is not None]
    return min(track.log_ns if logged or not stamps else stamps)
