"""`bcid ingest --check`: the health of all recordings, whatever is wrong with some."""

from bcid.cli.sink import Sink
from bcid.errors import InputRefused, PartLost, Problem, Problems
from bcid.pipeline.config import PipelineConfig
from bcid.vehicle import read_vehicle


def check_recordings(config: PipelineConfig, sink: Sink) -> None:
    """Read the recordings of a configuration, print whether each is worth fitting and why, and raise what is wrong.

    Raises:
        InputRefused: recordings are refused, with all their problems.
        PartLost: a part of a recording could not be read, as was allowed.
    """
    from bcid.cli import show
    from bcid.documents.health import HealthDocument
    from bcid.recording.checks.health import assess_health, refused_health
    from bcid.recording.formats.detect import find_commands_file
    from bcid.recording.read import read_recording

    vehicle, healths = read_vehicle(config.vehicle), []
    for path in config.recordings():
        try:
            commands = find_commands_file(path, config.commands)
            health = assess_health(read_recording(path, vehicle, commands, config.allow_partial), vehicle)
        except InputRefused as refusal:
            health = refused_health(refusal)
        except OSError as error:
            cause = f"cannot be read: {error.strerror or error}"
            health = refused_health(InputRefused(path, "file", cause, "check the path and who may read it"))
        healths.append(health.model_copy(update={"recording": str(path)}))
    document = HealthDocument(recordings=tuple(healths))
    sink.result(document.as_json(), lambda: show.health_text(document))
    Problems(Problem(**p.as_json()) for t in healths for p in t.problems).raise_if_any("recordings")
    lost = [t.recording for t in healths if t.lost]
    if lost:
        raise PartLost(f"a part is lost: {', '.join(lost)}\n  next: repair or record it again")
