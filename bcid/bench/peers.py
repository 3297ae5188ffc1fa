"""What a user would fit instead: a perceptron in torch, pysindy, a deepSI subspace encoder; judged as our models are.

Each is given the smoothed twist and the commands; the first two the steering angle as well, which they then predict
themselves.  Settings are what their documentation begins with, sized to the data.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import redirect_stderr, redirect_stdout
from io import StringIO
from tempfile import TemporaryDirectory
from typing import Any, Protocol, Self
from unittest.mock import patch

import numpy as np

from bcid.aliases import Floats
from bcid.estimate.types import Estimate
from bcid.models.interface import History, Scans

EPOCHS, BATCH, HIDDEN, RATE = 100, 256, (128, 64), 1e-3
DEGREE, THRESHOLD = 2, 1e-3
STATES, PAST, AHEAD, ITERATIONS, VALIDATED = 10, 20, 20, 10_000, 100


class Peer(Scans, Protocol):
    """A model that can be fitted and driven."""

    @classmethod
    def fit(cls, estimates: Sequence[Estimate], seed: int) -> Self:
        """One fitted to the takes."""


def _rows(estimates: Sequence[Estimate]) -> list[tuple[Floats, Floats]]:
    """States [twist, delta] (n, 4) and commands (n, 2) of each uninterrupted stretch."""
    return [
        (np.column_stack([e.twist[s], e.kinematic[s, 3]]), e.command[s])
        for e in estimates for s in e.segments() if s.stop - s.start > PAST + AHEAD
    ]  # fmt: skip


class _Stepped:
    """A next state from the state [twist, delta] and the command."""

    lags = 0

    def after(self, state: Floats, command: Floats) -> Floats:
        """The state one period later."""
        raise NotImplementedError

    def init(self, history: History) -> Floats:
        """The state at the history's last row."""
        return np.append(history.twist[-1], history.kinematic[-1, 3])

    def scan(self, carry: Floats, commands: Floats) -> tuple[Floats, Floats]:
        """See `Model.scan`."""
        twists = np.full((len(commands), 3), np.nan)
        for k, command in enumerate(commands):
            carry = self.after(carry, command)
            if not (np.abs(carry) < 1e6).all():  # it has left all numbers that mean anything
                break
            twists[k] = carry[:3]
        return carry, twists


class TorchMlp(_Stepped):
    """A perceptron from state and command to the change of state, trained on single steps."""

    name = "torch MLP"

    def __init__(self, net: Any, x: tuple[Floats, Floats], y: tuple[Floats, Floats]) -> None:
        self.net, self.x, self.y = net, x, y

    @classmethod
    def fit(cls, estimates: Sequence[Estimate], seed: int) -> Self:
        """By Adam on batches drawn anew in every epoch."""
        import torch
        from torch import nn

        torch.set_num_threads(1)
        torch.manual_seed(seed)
        parts = _rows(estimates)
        x = np.concatenate([np.column_stack([s[:-1], u[:-1]]) for s, u in parts])
        y = np.concatenate([np.diff(s, axis=0) for s, _ in parts])
        moments = [(v.mean(axis=0), v.std(axis=0) + 1e-9) for v in (x, y)]
        inputs, targets = (
            torch.tensor((v - m) / d, dtype=torch.float32) for v, (m, d) in zip((x, y), moments, strict=True)
        )
        a, b = HIDDEN
        net = nn.Sequential(nn.Linear(6, a), nn.ReLU(), nn.Linear(a, b), nn.ReLU(), nn.Linear(b, 4))
        adam = torch.optim.Adam(net.parameters(), lr=RATE)
        for _ in range(EPOCHS):
            for rows in torch.randperm(len(inputs)).split(BATCH):  # type: ignore[no-untyped-call]
                loss = nn.functional.mse_loss(net(inputs[rows]), targets[rows])
                adam.zero_grad()
                loss.backward()  # type: ignore[no-untyped-call]
                adam.step()
        return cls(net.eval(), *moments)

    def after(self, state: Floats, command: Floats) -> Floats:
        """See `_Stepped`."""
        import torch

        with torch.no_grad():
            x = torch.tensor((np.r_[state, command] - self.x[0]) / self.x[1], dtype=torch.float32)
            return np.asarray(state + self.y[0] + self.y[1] * self.net(x).numpy().astype(float))


class PySindy(_Stepped):
    """Polynomials of state and command, thresholded, in discrete time."""

    name = "pysindy"

    def __init__(self, model: Any) -> None:
        self.model = model

    @classmethod
    def fit(cls, estimates: Sequence[Estimate], seed: int) -> Self:
        """Sequentially thresholded least squares; nothing of it is random."""
        import pysindy as ps

        parts = _rows(estimates)
        model = ps.DiscreteSINDy(
            optimizer=ps.STLSQ(threshold=THRESHOLD), feature_library=ps.PolynomialLibrary(degree=DEGREE)
        )
        model.fit([s for s, _ in parts], t=1.0, u=[u for _, u in parts])
        return cls(model)

    def after(self, state: Floats, command: Floats) -> Floats:
        """See `_Stepped`."""
        return np.asarray(self.model.predict(state[None], u=command[None])[0], dtype=np.float64)


class DeepSi:
    """deepSI's subspace encoder network, which is a NARX model with a state: trained on stretches of 2 s."""

    name = "deepSI SUBNET"
    lags = PAST

    def __init__(self, model: Any) -> None:
        self.model = model

    @classmethod
    def fit(cls, estimates: Sequence[Estimate], seed: int) -> Self:
        """By Adam; the last tenth of the stretches says when it was best."""
        import deepSI
        import torch

        torch.set_num_threads(1)
        torch.manual_seed(seed)
        np.random.seed(seed)  # noqa: NPY002  # the library draws its batches from it
        data = [deepSI.Input_output_data(u=u, y=s[:, :3]) for s, u in _rows(estimates)]
        whole = np.cumsum([len(d) for d in data])
        cut = max(1, int(np.searchsorted(whole, 0.9 * whole[-1])))
        train, held = (data[:cut], data[cut:]) if cut < len(data) else _divided(data)
        nu, ny, norm = deepSI.get_nu_ny_and_auto_norm(train)
        model = deepSI.SUBNET(nu, ny, norm, nx=STATES, nb=PAST, na=PAST)
        stretches = sum(len(d) - PAST - AHEAD for d in train)
        with (
            TemporaryDirectory() as folder, patch("deepSI.fitting.get_checkpoint_dir", lambda: folder),
            redirect_stdout(StringIO()), redirect_stderr(StringIO()),
        ):  # fmt: skip
            done = deepSI.fit(
                model, train, held, n_its=ITERATIONS, T=AHEAD, batch_size=min(BATCH, stretches), val_freq=VALIDATED
            )
        return cls(done["best_model"].eval())

    def init(self, history: History) -> Any:
        """The measured past; the state is encoded with the first command, so that the last twist counts too."""
        import torch

        u, y = (torch.tensor(v, dtype=torch.float32) for v in (history.command[1 - PAST :], history.twist[-PAST:]))
        return u, y

    def scan(self, carry: Any, commands: Floats) -> tuple[Any, Floats]:
        """See `Model.scan`."""
        import torch

        twists = np.empty((len(commands), 3))
        with torch.no_grad():
            for k, u in enumerate(torch.tensor(commands, dtype=torch.float32)):
                if isinstance(carry, tuple):
                    carry = self.model.encoder(torch.cat([carry[0], u[None]])[None], carry[1][None])
                else:
                    carry = self.model.f(carry, u[None])
                twists[k] = self.model.h(carry)[0].numpy()
        return carry, twists


def _divided(data: Sequence[Any]) -> tuple[list[Any], list[Any]]:
    """The last stretch cut in two where nine tenths of it have passed."""
    last = data[-1]
    cut = int(0.9 * len(last))
    return [*data[:-1], last[:cut]], [last[cut:]]


PEERS: dict[str, type[Peer]] = {"torch": TorchMlp, "pysindy": PySindy, "deepSI": DeepSi}
"""By the package that each needs."""
