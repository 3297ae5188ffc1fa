"""The stages of recordings: `ingest`, `tune`, `estimate`, `check`; and which recordings are refused."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bcid.aliases import Progress
from bcid.errors import InputRefused, PartLost, Problem, Problems
from bcid.pipeline.stage_runner import StageRunner
from bcid.pipeline.takes import name_takes, refuse_repeats
from bcid.recording.cuts import split_cut, without_cut
from bcid.recording.formats.detect import detect_format, find_commands_file, recording_files
from bcid.store.artifact import Artifact, file_sha256

if TYPE_CHECKING:
    from bcid.evaluation.seen_takes import TakeSteps

AXLE_KEYS = ("body.cog_to_front_m", "body.cog_to_rear_m")
ESTIMATOR_KEYS = (*AXLE_KEYS, "body.drive", "body.front_drive_share", "steering")


class TakeStages:
    """The artifacts of a configuration's recordings; each recording is read and checked once."""

    def __init__(self, runner: StageRunner) -> None:
        """Nothing is read before it is asked for."""
        self.runner = runner
        # what each recording is called where several are shown
        self.names = name_takes([*runner.config.recordings(), *runner.config.diagnose])
        self._ingested: dict[Path, Artifact] = {}
        self._estimated: dict[Path, Artifact] = {}
        self._usable: set[Path] = set()
        self._tuned: Artifact | None = None
        self._steps: dict[Path, TakeSteps] = {}

    def title(self, recording: Path) -> str:
        """The recording's file name for messages, with as many folders as tell it apart from the others."""
        name = self.names.get(recording, recording.stem)
        return str(Path(name).parent / recording.name) if "/" in name else recording.name

    def validation_recording(self) -> Path:
        """Path of the validation recording; raise `InputRefused` where none is named."""
        config = self.runner.config
        if config.validation is None:
            next_step = 'add validation = "…" to the pipeline file'
            raise InputRefused(config.source, "validation", "no validation take is named", next_step)
        return config.validation

    # --- the stages -------------------------------------------------------------------------------------------------

    def ingest(self, recording: Path) -> Artifact:
        """Artifact of one ingested recording: poses, commands and irregularities."""
        if recording not in self._ingested:
            self._ingested[recording] = self._ingest(recording)
        return self._ingested[recording]

    def _ingest(self, recording: Path) -> Artifact:
        """Artifact of one ingested recording, found by the content of its files."""
        config, vehicle = self.runner.config, self.runner.vehicle
        file, cut = split_cut(recording)
        kind, commands = detect_format(file), find_commands_file(file, config.commands)
        tables = {"mcap": ("topics",), "motive": ("commands",), "table": ("columns", "commands")}[kind]
        inputs: dict[str, Any] = {
            "recording": "+".join(file_sha256(part) for part in recording_files(file)),
            "name": recording.name,
            "commands": file_sha256(commands) if commands is not None and commands.is_file() else None,
            "vehicle": self.runner.vehicle_parts(*AXLE_KEYS, "steering", "motor", "mocap", "command", "clock", *tables),
        }

        def make(folder: Path, progress: Progress) -> None:
            from bcid.pipeline.stages import ingest

            ingest.run_ingest_stage(folder, file, commands, vehicle, config.allow_partial, cut)

        settings = {"allow_partial": True} if config.allow_partial else {}
        return self.runner.run_stage("ingest", self.title(recording), inputs, settings, make)

    def tune(self) -> Artifact:
        """Artifact of the estimator's tuning to the training recordings.

        Raises:
            InputRefused: a training recording is given twice, which would count for two.
        """
        if self._tuned is None:
            self._tuned = self._tune()
        return self._tuned

    def _tune(self) -> Artifact:
        """Artifact of the tuning, found by the content of all training recordings."""
        config, vehicle, table = self.runner.config, self.runner.vehicle, self.runner.config.estimate
        self.refuse_repeats(config.training, (), "training", "name each take once")
        takes = [self.ingest(p) for p in config.training]
        noise = {k: v for k, v in table.noise.model_dump().items() if v is not None}
        inputs = {"recordings": [a.content for a in takes], "vehicle": self.runner.vehicle_parts(*ESTIMATOR_KEYS)}
        settings = {"period_s": table.period_s, "max_gap_s": table.max_gap_s, "noise": noise}

        def make(folder: Path, progress: Progress) -> None:
            from bcid.pipeline.stages import tune

            progress(0.0, "noise by likelihood")
            tune.run_tune_stage(folder, [a.folder for a in takes], vehicle, table.period_s, table.max_gap_s, noise)

        return self.runner.run_stage("tune", "estimator", inputs, settings, make)

    def estimate(self, recording: Path) -> Artifact:
        """Artifact of the smoothed motion of one recording."""
        if recording not in self._estimated:
            self._estimated[recording] = self._estimate(recording)
        return self._estimated[recording]

    def _estimate(self, recording: Path) -> Artifact:
        """Artifact of the motion, found by the content of the recording and of all training recordings."""
        taken, tuned = self.ingest(recording), self.tune()
        vehicle, table = self.runner.vehicle, self.runner.config.estimate
        parts = self.runner.vehicle_parts(*ESTIMATOR_KEYS)
        inputs = {"recording": taken.content, "tuning": tuned.content, "vehicle": parts}
        settings = {"period_s": table.period_s, "max_gap_s": table.max_gap_s, "engine": table.engine}

        def make(folder: Path, progress: Progress) -> None:
            from bcid.pipeline.stages import estimate

            estimate.run_estimate_stage(
                folder, taken.folder, tuned.folder, vehicle, table.period_s, table.max_gap_s, table.engine
            )

        return self.runner.run_stage("estimate", self.title(recording), inputs, settings, make)

    def check(self, recording: Path) -> Artifact | None:
        """Artifact of the estimator's errors against a simulated recording's truth; None where no truth is known."""
        truth = self._truth(recording)
        if truth is None:
            return None
        taken, tuned = self.ingest(recording), self.tune()
        vehicle, table = self.runner.vehicle, self.runner.config.estimate
        inputs = {
            "recording": taken.content, "tuning": tuned.content, "truth": file_sha256(truth),
            "vehicle": self.runner.vehicle_parts(*ESTIMATOR_KEYS),
        }  # fmt: skip
        settings = {"period_s": table.period_s, "max_gap_s": table.max_gap_s}

        def make(folder: Path, progress: Progress) -> None:
            from bcid.pipeline.stages import check

            check.run_check_stage(folder, taken.folder, tuned.folder, vehicle, table.period_s, table.max_gap_s, truth)

        return self.runner.run_stage("check", self.title(recording), inputs, settings, make)

    def _truth(self, recording: Path) -> Path | None:
        """The file of a simulated recording's truth, NAME.parquet in the folder of truths; None where there is none.

        Raises:
            InputRefused: there is no such folder, or the file may be that of several recordings.
        """
        config = self.runner.config
        if config.truth is None:
            return None
        if not config.truth.is_dir():
            raise InputRefused(config.source, "truth", f"{config.truth} is no folder", "correct or remove it")
        file = without_cut(recording)
        truth = config.truth / f"{file.stem}.parquet"
        if not truth.exists():
            return None
        files = dict.fromkeys(without_cut(p) for p in config.recordings())
        alike = [p for p in files if p.stem == file.stem]
        if len(alike) > 1:
            cause = f"{truth} may be of any of {', '.join(map(str, alike))}"
            raise InputRefused(config.source, "truth", cause, "give the takes other names, or remove truth")
        return truth

    # --- what is refused --------------------------------------------------------------------------------------------

    def raise_if_parts_lost(self) -> None:
        """Raise `PartLost` where a part of a recording that has been ingested so far could not be read."""
        from bcid.recording.saving import RecordingSummary

        ingested = [a.folder for a in self.runner.known.values() if a.folder.parent.name == "ingest"]
        summaries = [RecordingSummary.read(folder / "recording.json") for folder in ingested]
        lost = [f"{s.name}: {i.detail}" for s in summaries for i in s.irregularities if i.kind == "lost"]
        if lost:
            raise PartLost(f"a part of the input is lost: {'; '.join(lost)}\n  next: repair or record it again")

    def refuse_unusable(self, recordings: Sequence[Path]) -> None:
        """Raise `InputRefused` where the check of a recording says no-go, with causes and next steps of all.

        Nothing is raised where the configuration says to ignore the recordings' health.
        """
        from bcid.recording.saving import RecordingSummary

        config, problems = self.runner.config, Problems()
        for recording in [] if config.ignore_health else dict.fromkeys(recordings):
            folder = self.ingest(recording).folder
            if recording in self._usable:
                continue
            if all(odd.action != "no-go" for odd in RecordingSummary.read(folder / "recording.json").irregularities):
                self._usable.add(recording)
            else:
                problems.extend(self._why_unusable(recording, folder))
        problems.raise_if_any(config.source)

    def _why_unusable(self, recording: Path, ingested: Path) -> list[Problem]:
        """What the check of a recording says no-go for, in the folder `ingested`, and what to do about each."""
        # it needs the checks, which are slow to import
        from bcid.recording.neighbours import name_fitting_commands
        from bcid.recording.saving import load_recording

        checked = name_fitting_commands(without_cut(recording), load_recording(ingested), self.runner.vehicle)
        problems = []
        for odd in checked.irregularities:
            if odd.action == "no-go":
                cause, _, mend = odd.detail.rpartition("; ")
                step = f"{mend} (or --ignore-health uses the take as it is)"
                problems.append(Problem(odd.kind, f"no-go: {cause}", step, str(recording)))
        return problems

    def steps(self, recording: Path) -> TakeSteps:
        """The steps of a recording, by which it is known again under another name or in another format."""
        from bcid.evaluation.seen_takes import read_take_steps

        if recording not in self._steps:
            self._steps[recording] = read_take_steps(self.ingest(recording).folder)
        return self._steps[recording]

    def refuse_repeats(self, recordings: Sequence[Path], against: Sequence[Path], place: str, next_step: str) -> None:
        """Raise `InputRefused` where one of `recordings` is of the drive of one `against` it, or of an earlier one."""
        refuse_repeats(recordings, against, self.steps, self.runner.config.source, place, next_step)

    def refuse_seen_validation(self) -> None:
        """Raise `InputRefused` where the validation recording is of the drive of a training recording."""
        unseen = "name a take that no model is fitted on, or cut one take into two"
        self.refuse_repeats([self.validation_recording()], self.runner.config.training, "validation", unseen)
