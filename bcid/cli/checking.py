"""`bcid ingest --check`: the health of all recordings, whatever is wrong with some."""

from bcid.cli.sink import Sink
from bcid.errors import InputRefused, PartLost, Problem, Problems
from bcid.pipeline.config import PipelineConfig
from bcid.vehicle import read_vehicle

REMEDY = "mend what is told of it, or drive it again"


def check_recordings(config: PipelineConfig, sink: Sink) -> None:
    """Read the recordings of a configuration, print whether each is worth fitting and why, and raise what is wrong.

    Raises:
        InputRefused: recordings are refused or no-go, with all their problems.
        PartLost: a part of a recording could not be read, as was allowed.
    """
    from bcid.cli import show
    from bcid.documents.health import HealthDocument
    from bcid.recording.checks.health import assess_health, refused_health
    from bcid.recording.cuts import read_named_recording, without_cut
    from bcid.recording.neighbours import name_fitting_commands

    vehicle, healths = read_vehicle(config.vehicle), []
    for path in config.recordings():
        try:
            recording = read_named_recording(path, vehicle, config.commands, config.allow_partial)
            health = assess_health(name_fitting_commands(without_cut(path), recording, vehicle), vehicle)
        except InputRefused as refusal:
            health = refused_health(refusal)
        except OSError as error:
            cause = f"cannot be read: {error.strerror or error}"
            health = refused_health(InputRefused(path, "file", cause, "check the path and who may read it"))
        healths.append(health.model_copy(update={"recording": str(path)}))
    document = HealthDocument(recordings=tuple(healths))
    sink.result(document.as_json(), lambda: show.health_text(document))
    problems = Problems(Problem(**p.as_json()) for t in healths for p in t.problems)
    # the reasons stand in the sentence that is printed already
    problems += [Problem("health", "no-go", REMEDY, t.recording) for t in healths if not t.go and not t.problems]
    problems.raise_if_any("recordings")
    lost = [t.recording for t in healths if t.lost]
    if lost:
        raise PartLost(f"a part is lost: {', '.join(lost)}\n  next: repair or record it again")
