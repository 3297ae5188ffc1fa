"""A saved model with all that is known of it: it predicts, and advances a motion step by step."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from os import PathLike
from pathlib import Path

import numpy as np

from bcid.aliases import Floats
from bcid.errors import UsageError
from bcid.evaluation.validity import FILE_NAME as VALIDITY_FILE
from bcid.evaluation.validity import ModelValidity, load_validity
from bcid.files.outputs import refuse_to_overwrite, staged_outputs
from bcid.models.interface import Model
from bcid.models.saving import FILES as MODEL_FILES
from bcid.models.saving import load_model, model_digest, save_model
from bcid.prediction.commands import command_array_parts, read_command_parts, recorded_command_parts
from bcid.prediction.motion import Motion
from bcid.prediction.prediction import BeyondData, Prediction, predict_from
from bcid.prediction.start import InitialState, Moment, State, find_row, start_from_row, start_from_state

AT_REST = State()
Commands = str | PathLike[str] | Floats | Sequence[Sequence[float]]
"""A commands file, or an array: [u_s (rad), u_m] (N, 2) of each period, or parts (N, W, 4)."""


@dataclass(frozen=True)
class FittedModel:
    """A fitted model, what is known of where it holds, and the folder that it was loaded from."""

    model: Model
    validity: ModelValidity | None  # None where nobody wrote it down
    folder: Path
    sha256: str  # of its model.json

    @property
    def name(self) -> str:
        """The model's name, such as "newton-euler"."""
        return self.model.name

    @property
    def period_s(self) -> float:
        """The time (s) by which a step advances."""
        return self.model.period_s

    def describe(self) -> str:
        """The fitted equations with values and units, for people."""
        return self.model.describe()

    def predict(
        self,
        commands: Commands | None = None,
        start: State | Moment = AT_REST,
        duration_s: float | None = None,
        *,
        stacklevel: int = 2,
    ) -> Prediction:
        """Predict pose and twist, with their covariance, from a state or from a moment of a recording.

        Args:
            commands: a commands file, whose time 0 is the start, or an array of them, one row a period; None drives
                on as the recording did, and needs a moment of one.
            start: a state, at rest in the origin unless it is given, or a moment of an estimated recording.
            duration_s: the time (s) to predict; None for as long as there are commands.
            stacklevel: whose line a warning names, as in `warnings.warn`; 2 for the caller's.

        Warns:
            BeyondData: once for each quantity that leaves the range of the data that the model was fitted on.

        Raises:
            UsageError: the arguments do not go together, or are no commands.
            InputRefused: a file or a moment cannot be used, or the prediction runs away.
        """
        prediction = self.predict_quietly(commands, start, duration_s)
        for text in prediction.exits:
            warnings.warn(f"beyond the data of {self.name}: {text}", BeyondData, stacklevel=stacklevel)
        return prediction

    def predict_quietly(self, commands: Commands | None, start: State | Moment, duration_s: float | None) -> Prediction:
        """Predict as `predict` does, without a warning: whoever calls it shows the prediction's `exits`.

        Raises:
            UsageError: the arguments do not go together, or are no commands.
            InputRefused: a file or a moment cannot be used, or the prediction runs away.
        """
        initial, parts = self._prepare(commands, start, duration_s)
        return predict_from(self.model, self.validity, initial, parts, str(self.folder))

    def begin(self, start: State | Moment = AT_REST) -> Motion:
        """The vehicle under way from a start, which `Motion.step` advances one period after the other.

        Warns:
            BeyondData: the start is outside the range of the data that the model was fitted on, once for each quantity.

        Raises:
            InputRefused: the moment is none of the recording.
        """
        if isinstance(start, State):
            initial = start_from_state(start, self.model, np.zeros(2))
        else:
            row = find_row(start, self.period_s)
            initial = start_from_row(start.estimate, row, self.model.lags)
        history = initial.history
        carry = self.model.init(history)
        motion = Motion(self.model, self.validity, carry, history.pose[-1], history.twist[-1], initial.time_s)
        beyond = self.validity.range.start_exits(motion.twist, initial.steering_angle) if self.validity else []
        return motion.warn_of(beyond, stacklevel=3)

    def save(self, folder: Path | str) -> FittedModel:
        """Save the model, and where it holds, in a folder that has no model yet; returns it as loaded from there.

        Raises:
            InputRefused: the folder holds one of the files already.
        """
        home = Path(folder)
        refuse_to_overwrite([home / name for name in (*MODEL_FILES, VALIDITY_FILE)], lambda path: False)
        with staged_outputs(home, lambda path: False) as staged:
            save_model(self.model, staged)
            if self.validity is not None:
                self.validity.save(staged)
        return load_fitted_model(home)

    def _prepare(
        self, commands: Commands | None, start: State | Moment, duration_s: float | None
    ) -> tuple[InitialState, Floats]:
        """The start of a prediction, and the parts (N, W, 4) of the commands that are driven from there."""
        if isinstance(start, State):
            if commands is None:
                raise UsageError("a prediction from a state needs commands\n  next: give a commands file, or an array")
            parts = self._command_parts(commands, duration_s)
            return start_from_state(start, self.model, parts[0, 0, 1:3]), parts
        row = find_row(start, self.period_s)
        initial = start_from_row(start.estimate, row, self.model.lags)
        if commands is None:
            return initial, recorded_command_parts(start.estimate, row, duration_s)
        return initial, self._command_parts(commands, duration_s)

    def _command_parts(self, commands: Commands, duration_s: float | None) -> Floats:
        """Parts (N, W, 4) of commands in a file or an array."""
        if isinstance(commands, str | PathLike):
            return read_command_parts(Path(commands), self.period_s, duration_s)
        try:
            array = np.asarray(commands, dtype=np.float64)
        except (TypeError, ValueError):
            raise UsageError(
                "commands are no array of numbers\n  next: give (N, 2), [u_s, u_m] of each period"
            ) from None
        return command_array_parts(array, self.period_s, duration_s)


def load_fitted_model(folder: Path) -> FittedModel:
    """Load the model in a folder, with its process noise and the range of its data where they were saved beside it.

    Raises:
        InputRefused: there is no model, or one of its files is damaged.
    """
    return FittedModel(load_model(folder), load_validity(folder), folder, model_digest(folder))
