"""Models that a user would fit instead: a perceptron in torch, pysindy, a deepSI subspace encoder; scored as ours are.

Each is given the smoothed twist and the commands; the first two the steering angle as well, which they then predict
themselves.  Settings are what their documentation begins with, sized to the data.
"""

from collections.abc import Sequence
from contextlib import redirect_stderr, redirect_stdout
from io import StringIO
from tempfile import TemporaryDirectory
from typing import Any, Protocol, Self
from unittest.mock import patch

import numpy as np

from bcid.aliases import Floats
from bcid.estimate.command_parts import mean_commands
from bcid.estimate.types import Estimate
from bcid.models.interface import History, SupportsRollout

# Settings of the perceptron in torch, of pysindy's polynomials, and of deepSI's encoder (PAST, AHEAD in samples).
EPOCHS, BATCH, HIDDEN, LEARNING_RATE = 100, 256, (128, 64), 1e-3
DEGREE, THRESHOLD = 2, 1e-3
STATES, PAST, AHEAD, ITERATIONS, VALIDATION_INTERVAL = 10, 20, 20, 10_000, 100
# Size of a state (SI) beyond which a one-step peer has diverged.
DIVERGED = 1e6


class Peer(SupportsRollout, Protocol):
    """A model that can be fitted to estimates and rolled out."""

    @classmethod
    def fit(cls, estimates: Sequence[Estimate], seed: int) -> Self:
        """A model of this kind fitted to the takes."""


def _states_and_commands(estimates: Sequence[Estimate]) -> list[tuple[Floats, Floats]]:
    """States [v_x, v_y, yaw rate, delta] (n, 4) and commands [u_s, u_m] (n, 2) of each segment of the estimates.

    Segments of at most PAST + AHEAD samples, too short to train deepSI's encoder on, are left out.
    """
    return [
        (np.column_stack([e.twist[s], e.kinematic[s, 3]]), e.command[s])
        for e in estimates for s in e.segments() if s.stop - s.start > PAST + AHEAD
    ]  # fmt: skip


class _OneStepPeer:
    """A peer that maps the state [v_x, v_y, yaw rate, delta] and the command to the next state."""

    lags = 0

    def next_state(self, state: Floats, command: Floats) -> Floats:
        """The state (4,) one period later under the command (2,)."""
        raise NotImplementedError

    def init(self, history: History) -> Floats:
        """The state (4,) at the history's last row."""
        return np.append(history.twist[-1], history.kinematic[-1, 3])

    def scan(self, carry: Floats, commands: Floats) -> tuple[Floats, Floats]:
        """The last state and the twists (N, 3) under commands (N, 2) or parts; NaN from where the state diverges."""
        twists = np.full((len(commands), 3), np.nan)
        for k, command in enumerate(commands if commands.ndim == 2 else mean_commands(commands)):
            carry = self.next_state(carry, command)
            if not (np.abs(carry) < DIVERGED).all():
                break
            twists[k] = carry[:3]
        return carry, twists


class TorchMlp(_OneStepPeer):
    """A perceptron in torch from state and command to the change of state, trained on single steps."""

    name = "torch MLP"

    def __init__(self, net: Any, x: tuple[Floats, Floats], y: tuple[Floats, Floats]) -> None:
        self.net, self.x, self.y = net, x, y

    @classmethod
    def fit(cls, estimates: Sequence[Estimate], seed: int) -> Self:
        """A perceptron trained by Adam on batches drawn anew in every epoch."""
        import torch
        from torch import nn

        torch.set_num_threads(1)
        torch.manual_seed(seed)
        parts = _states_and_commands(estimates)
        x = np.concatenate([np.column_stack([s[:-1], u[:-1]]) for s, u in parts])
        y = np.concatenate([np.diff(s, axis=0) for s, _ in parts])
        moments = [(v.mean(axis=0), v.std(axis=0) + 1e-9) for v in (x, y)]
        inputs, targets = (
            torch.tensor((v - m) / d, dtype=torch.float32) for v, (m, d) in zip((x, y), moments, strict=True)
        )
        a, b = HIDDEN
        net = nn.Sequential(nn.Linear(6, a), nn.ReLU(), nn.Linear(a, b), nn.ReLU(), nn.Linear(b, 4))
        adam = torch.optim.Adam(net.parameters(), lr=LEARNING_RATE)
        for _ in range(EPOCHS):
            for rows in torch.randperm(len(inputs)).split(BATCH):  # type: ignore[no-untyped-call]
                loss = nn.functional.mse_loss(net(inputs[rows]), targets[rows])
                adam.zero_grad()
                loss.backward()  # type: ignore[no-untyped-call]
                adam.step()
        return cls(net.eval(), *moments)

    def next_state(self, state: Floats, command: Floats) -> Floats:
        """The state (4,) plus the change that the perceptron predicts."""
        import torch

        with torch.no_grad():
            x = torch.tensor((np.r_[state, command] - self.x[0]) / self.x[1], dtype=torch.float32)
            return np.asarray(state + self.y[0] + self.y[1] * self.net(x).numpy().astype(float))


class PySindy(_OneStepPeer):
    """pysindy's sparse polynomials of state and command, in discrete time."""

    name = "pysindy"

    def __init__(self, model: Any) -> None:
        self.model = model

    @classmethod
    def fit(cls, estimates: Sequence[Estimate], seed: int) -> Self:
        """Polynomials by sequentially thresholded least squares; nothing is random, whatever the seed."""
        import pysindy as ps

        parts = _states_and_commands(estimates)
        model = ps.DiscreteSINDy(
            optimizer=ps.STLSQ(threshold=THRESHOLD), feature_library=ps.PolynomialLibrary(degree=DEGREE)
        )
        model.fit([s for s, _ in parts], t=1.0, u=[u for _, u in parts])
        return cls(model)

    def next_state(self, state: Floats, command: Floats) -> Floats:
        """The state (4,) that the polynomials predict."""
        return np.asarray(self.model.predict(state[None], u=command[None])[0], dtype=np.float64)


class DeepSiSubnet:
    """deepSI's subspace encoder network, a NARX model with a state, trained on stretches of AHEAD samples."""

    name = "deepSI SUBNET"
    lags = PAST

    def __init__(self, model: Any) -> None:
        self.model = model

    @classmethod
    def fit(cls, estimates: Sequence[Estimate], seed: int) -> Self:
        """A network trained by Adam; the last tenth of the stretches selects its best iteration."""
        import deepSI
        import torch

        torch.set_num_threads(1)
        torch.manual_seed(seed)
        np.random.seed(seed)  # noqa: NPY002  # the library draws its batches from it
        data = [deepSI.Input_output_data(u=u, y=s[:, :3]) for s, u in _states_and_commands(estimates)]
        whole = np.cumsum([len(d) for d in data])
        cut = max(1, int(np.searchsorted(whole, 0.9 * whole[-1])))
        train, validation = data[:cut], data[cut:]
        if not validation:
            at = int(0.9 * len(data[-1]))
            train, validation = [*data[:-1], data[-1][:at]], [data[-1][at:]]
        nu, ny, norm = deepSI.get_nu_ny_and_auto_norm(train)
        model = deepSI.SUBNET(nu, ny, norm, nx=STATES, nb=PAST, na=PAST)
        size = min(BATCH, sum(len(d) - PAST - AHEAD for d in train))
        with (
            TemporaryDirectory() as folder, patch("deepSI.fitting.get_checkpoint_dir", lambda: folder),
            redirect_stdout(StringIO()), redirect_stderr(StringIO()),
        ):  # fmt: skip
            done = deepSI.fit(
                model, train, validation, n_its=ITERATIONS, T=AHEAD, batch_size=size, val_freq=VALIDATION_INTERVAL
            )
        return cls(done["best_model"].eval())

    def init(self, history: History) -> Any:
        """The measured past as two tensors; `scan` encodes it with the first command, so that the last twist counts."""
        import torch

        u, y = (torch.tensor(v, dtype=torch.float32) for v in (history.command[1 - PAST :], history.twist[-PAST:]))
        return u, y

    def scan(self, carry: Any, commands: Floats) -> tuple[Any, Floats]:
        """The last state and the twists (N, 3) under commands (N, 2) or parts, from the measured past or a state."""
        import torch

        commands = commands if commands.ndim == 2 else mean_commands(commands)
        twists = np.empty((len(commands), 3))
        with torch.no_grad():
            for k, u in enumerate(torch.tensor(commands, dtype=torch.float32)):
                if isinstance(carry, tuple):
                    carry = self.model.encoder(torch.cat([carry[0], u[None]])[None], carry[1][None])
                else:
                    carry = self.model.f(carry, u[None])
                twists[k] = self.model.h(carry)[0].numpy()
        return carry, twists


PEERS: dict[str, type[Peer]] = {"torch": TorchMlp, "pysindy": PySindy, "deepSI": DeepSiSubnet}
"""Peers by the package that each needs."""
