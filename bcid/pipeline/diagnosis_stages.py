"""The stages of a diagnosis: `diagnose`, and `diagnosis_page`, which shows one."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

from bcid.aliases import Progress
from bcid.errors import InputRefused
from bcid.pipeline.model_stages import ModelStages
from bcid.pipeline.named_models import WITH_REMAINDER
from bcid.pipeline.origin import origin_key, trace_origin
from bcid.pipeline.progress import spread_rounds
from bcid.pipeline.stage_runner import SEEN_TAKES_MODULE, NotMadeYet, StageRunner
from bcid.pipeline.take_stages import TakeStages
from bcid.recording.cuts import without_cut
from bcid.store.artifact import Artifact, file_sha256


class IngestedMotion(NamedTuple):
    """A recording as a diagnosis takes it: the artifacts of what was read, and of the motion estimated from it."""

    recording: Artifact
    motion: Artifact

    @property
    def content(self) -> list[str]:
        """Digests of both, for a key."""
        return [self.recording.content, self.motion.content]


class DiagnosisStages:
    """The diagnosis of a configuration's recordings, and its page."""

    def __init__(self, runner: StageRunner, takes: TakeStages, models: ModelStages) -> None:
        """`takes` has the recordings, and `models` loads a saved model that they are compared with."""
        self.runner = runner
        self.takes = takes
        self.models = models

    def recordings(self) -> list[Path]:
        """The recordings that are diagnosed: those that the configuration lists for it, else those to be trained on.

        The validation take stays one that no model has seen.
        """
        config = self.runner.config
        return list(config.diagnose or config.training)

    def diagnose(self, simulation: str | None = None) -> Artifact:
        """Artifact of the diagnosis: what physics the recordings show that the base model, or `simulation`, lacks.

        `simulation` is a saved model's folder, a TOML file of parameters, another simulator's recording of the car, or
        module:function.
        """
        # the user's effects are read before anybody has waited
        own_effects, recordings, vehicle = self.runner.own_effects, self.recordings(), self.runner.vehicle
        self.takes.refuse_unusable([*recordings, *self.runner.config.training])
        twice = "name each take once: two would count as twice the evidence"
        self.takes.refuse_repeats(recordings, (), "diagnose", twice)
        taken, tuned = [self._motion(p) for p in recordings], self.takes.tune()
        path = Path(simulation) if simulation is not None else None
        simulated = [self._motion(path)] if path is not None and _is_recording(path) else []
        names = [self.takes.names[p] for p in recordings]
        inputs = {
            "takes": [take.content for take in taken],
            "tuning": tuned.content,
            "vehicle": self.runner.vehicle_parts("body", "steering", "motor", "name"),
            "simulated": [take.content for take in simulated],
            "simulation": None if path is None or simulated else self._simulation_key(path),
            "names": names,
        }
        if own_effects is not None:
            inputs["effects"] = own_effects.sha256

        def make(folder: Path, progress: Progress) -> None:
            from bcid.evaluation.seen_takes import save_seen_takes
            from bcid.pipeline.stages import diagnose

            diagnose.run_diagnose_stage(
                folder, [take.recording.folder for take in taken], [take.motion.folder for take in taken], names,
                tuned.folder, vehicle, simulation, [(take.recording.folder, take.motion.folder) for take in simulated],
                spread_rounds(progress),
            )  # fmt: skip
            for made in (folder / "model", folder / WITH_REMAINDER):
                if made.is_dir():
                    save_seen_takes([self.takes.steps(p) for p in recordings], made)

        return self.runner.run_stage("diagnose", "", inputs, {}, make, SEEN_TAKES_MODULE, own_effects=True)

    def find_diagnosis(self) -> Artifact | None:
        """Artifact of the diagnosis of the configuration's recordings; None where none was made of them as they are."""
        config = self.runner.config
        if not (config.diagnose and (config.workspace / "diagnose").is_dir()):
            return None
        try:
            return DiagnosisStages(self.runner.only_reusing(), self.takes, self.models).diagnose()
        except (NotMadeYet, InputRefused):
            return None

    def diagnosis_page(self, diagnosis: Artifact) -> Artifact:
        """Artifact of the page of a diagnosis of this configuration's recordings, and of the card of its model.

        The page says when it was made and by which command, which do not count in its key: the page that was made first
        stays.
        """
        origin = trace_origin(self.takes, self.recordings())
        inputs = {"diagnosis": diagnosis.content, **origin_key(origin)}

        def make(folder: Path, progress: Progress) -> None:
            from bcid.pipeline.stages import diagnosis_page

            diagnosis_page.run_diagnosis_page_stage(folder, diagnosis.folder, origin)

        return self.runner.run_stage("diagnosis_page", "", inputs, {}, make, own_effects=True)

    def _motion(self, recording: Path) -> IngestedMotion:
        """A recording, read, and its estimated motion."""
        return IngestedMotion(self.takes.ingest(recording), self.takes.estimate(recording))

    def _simulation_key(self, simulation: Path) -> Any:
        """What stands for a simulation in a key: digests of its files, or the name and file of a module.

        A module is not cached reliably, since what it imports is not seen.
        """
        if simulation.is_dir():
            return self.models.load_for_comparison(simulation).content
        if simulation.is_file():
            return file_sha256(simulation)
        module = Path(str(simulation).partition(":")[0].replace(".", "/") + ".py")
        return [str(simulation), file_sha256(module) if module.is_file() else None]


def _is_recording(simulation: Path) -> bool:
    """Whether a simulation is named by a recording that it made, not by its parameters, a saved model or a module."""
    return without_cut(simulation).is_file() and simulation.suffix != ".toml"
