"""How one stage is run: under a key that covers all it depends on, reused where it is there, followed by a watcher."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager, nullcontext
from copy import copy
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bcid.aliases import Progress
from bcid.errors import InputRefused
from bcid.files.source_code import stage_code
from bcid.pipeline.config import PipelineConfig
from bcid.pipeline.watching import Watcher
from bcid.store.artifact import Artifact, Recipe, Store, is_whole
from bcid.vehicle import read_vehicle

if TYPE_CHECKING:
    from bcid.effects.own_file import OwnFile

COSTLY_STAGES = ("fit", "diagnose")
"""Stages that take minutes; a report of what is there waits for none of them."""
SEEN_TAKES_MODULE = "bcid.evaluation.seen_takes"
"""The code that notes which takes a model was made from; it counts in the keys of stages that make one."""


class NotMadeYet(Exception):
    """A fit or a diagnosis is not in the workspace, and was only to be reused."""


class StageRunner:
    """Runs stages for one configuration, each once, and keeps what they make in its workspace."""

    def __init__(self, config: PipelineConfig, watcher: Watcher | None = None) -> None:
        """Read the vehicle file and open the store of `config`; `watcher` follows the stages as they run."""
        self.config = config
        self.vehicle = read_vehicle(config.vehicle)
        self.watcher = watcher or Watcher()
        waiting = f"waiting for another run, which is at work in {config.workspace}"
        self.store = Store(config.workspace, lambda: self.watcher.report_locked(waiting), self.watcher.note)
        # by key, what this runner or one derived from it has made or found
        self.known: dict[str, Artifact] = {}
        self._makes_costly = True

    def with_config(self, config: PipelineConfig) -> StageRunner:
        """This runner for another configuration of the same vehicle and workspace; it shares all that is known."""
        other = copy(self)
        other.config = config
        return other

    def only_reusing(self) -> StageRunner:
        """This runner without fits and diagnoses that are not there: `NotMadeYet` is raised for such."""
        other = copy(self)
        other._makes_costly = False
        return other

    def run_stage(
        self, stage: str, subject: str, inputs: Mapping[str, Any], settings: Mapping[str, Any],
        make: Callable[[Path, Progress], None], *modules: str, seed: int | None = None, own_effects: bool = False,
    ) -> Artifact:  # fmt: skip
        """Return the stage's artifact, from the cache where it is there, else made by `make(folder, progress)`.

        `subject` stands after the stage's name in messages; `modules` run beside the stage's own and count in its key.
        The user's file of effects is code: it is run, and in use, only where the stage needs `own_effects`.

        Raises:
            NotMadeYet: it is a fit or a diagnosis that is not there, and this runner only reuses such.
        """
        recipe = Recipe(stage, inputs, settings, stage_code(f"bcid.pipeline.stages.{stage}", *modules), seed)
        title = f"{stage} {subject}".rstrip()
        if recipe.key in self.known:
            return self.known[recipe.key]
        only_reused = stage in COSTLY_STAGES and not self._makes_costly
        if only_reused and not is_whole(self.config.workspace / stage / recipe.key, recipe):
            raise NotMadeYet

        def watched(folder: Path) -> None:
            with self.watcher.stage(title) as progress, self.own_effects_in_use(own_effects):
                make(folder, progress)

        artifact = self.store.get_or_make(recipe, watched)
        if artifact.reused:
            self.watcher.report_reused(title)
        self.known[recipe.key] = artifact
        return artifact

    @cached_property
    def own_effects(self) -> OwnFile | None:
        """The user's own effects: of the file that the configuration names, read and checked, or of one in use already.

        None where there is neither.

        Raises:
            InputRefused: the file is wrong, or nobody named it, nor the pipeline file that names it: it is code.
        """
        from bcid.effects.own_file import IN_USE, read_own_effects

        if self.config.effects is None:
            return IN_USE[0] if IN_USE else None
        self.refuse_unnamed_effects()

        return read_own_effects(self.config.effects)

    def refuse_unnamed_effects(self) -> None:
        """Raise `InputRefused` where the user's file of effects is named only by a pipeline file that nobody named."""
        if self.config.effects is not None and not self.config.effects_named:
            cause = f"names {self.config.effects}, a program that would be run; this pipeline file was only found here"
            step = f"read that file; if you trust it, give --effects {self.config.effects}, or -p {self.config.source}"
            raise InputRefused(self.config.source, "effects", cause, step)

    def own_effects_of(self, model: Path) -> AbstractContextManager[None]:
        """Context in which the model saved in the folder `model` can be loaded and used.

        The user's own effects are in the vocabulary where the model has some.

        Raises:
            InputRefused: the user's file of effects is wrong, or nobody named it.
        """
        from bcid.models.saving import has_own_effects

        return self.own_effects_in_use(has_own_effects(model))

    def own_effects_in_use(self, needed: bool) -> AbstractContextManager[None]:
        """Context in which the vocabulary holds the user's own effects beside its own, if they are `needed`."""
        if not needed or self.own_effects is None:
            return nullcontext()
        from bcid.effects.own_file import own_effects_in_use

        return own_effects_in_use(self.own_effects)

    def vehicle_parts(self, *parts: str) -> dict[str, Any]:
        """Parts of the vehicle file that a stage depends on: keys such as `body.mass_kg`, or whole tables."""
        tables = self.vehicle.model_dump(mode="json", by_alias=True)
        split = {part: part.partition(".") for part in parts}
        return {part: tables[table][key] if key else tables[table] for part, (table, _, key) in split.items()}
