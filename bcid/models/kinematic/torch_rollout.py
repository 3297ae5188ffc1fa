"""The kinematic models' rollouts in torch, for training: the same equations as `bcid.models.kinematic.frame`."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from bcid.aliases import Ints
from bcid.models.fitting.windows import Windows
from bcid.models.kinematic.frame import SLIP_LIMIT, Frame
from bcid.models.kinematic.library import ABS_AF, ABS_DELTA, ABS_RATE, AF, AR, BRAKE, DELTA, FACTORS, RATE, THROTTLE, V
from bcid.models.kinematic.sparse_sum import Sparse
from bcid.models.network.training import Network, Unrolled
from bcid.physics.steering import steering_step

if TYPE_CHECKING:
    from torch import Tensor


STILL = 1e-8  # m^2/s^2: below it an energy has no useful slope


def with_servo(taken: Windows, c: Frame) -> Windows:
    """The stretches with the steering angles that the servo gives from their starts on; it knows no other state."""
    kinematic = taken.kinematic.copy()
    for b in range(taken.number):
        for k in range(taken.steps):
            kinematic[b, k + 1, 3] = steering_step(kinematic[b, k, 3], taken.command[b, k, 0], c.T_s, c.d, c.period)
    return taken._replace(kinematic=kinematic)


def twist_of(v_f: Tensor, alpha_f: Tensor, alpha_r: Tensor, delta: Tensor, c: Frame) -> Tensor:
    """Twists (B, 3): see `bcid.models.kinematic.frame.twist_of`."""
    import torch

    beta_f, beta_r = delta + alpha_f, alpha_r.clamp(-SLIP_LIMIT, SLIP_LIMIT)
    v_x, v_fy = torch.cos(beta_f) * v_f, torch.sin(beta_f) * v_f
    v_ry, wheelbase = v_x * torch.tan(beta_r), c.l_f + c.l_r
    return torch.stack([v_x, (c.l_r * v_fy + c.l_f * v_ry) / wheelbase, (v_fy - v_ry) / wheelbase], dim=1)


def unrolled(c: Frame, after: Callable[[Network, Tensor], Tensor], dissipative: bool = False) -> Unrolled:
    """The rollout of a model: of [v_f, alpha_f, alpha_r, delta, u_s, u_m] `after` gives the first three a step on.

    A dissipative one gains no kinetic energy without throttle: see `bcid.models.kinematic.frame.without_gain`.
    """
    import torch

    def run(network: Network, twist: Tensor, kinematic: Tensor, command: Tensor) -> Tensor:
        state, out = kinematic[:, 0, :3], []
        moving = twist_of(state[:, 0], state[:, 1], state[:, 2], kinematic[:, 0, 3], c)
        for k in range(kinematic.shape[1] - 1):
            x = torch.cat([state, kinematic[:, k, 3:], command[:, k]], dim=1)
            following = after(network, x)
            state = torch.cat([following[:, :1].clamp(min=0.0), following[:, 1:]], dim=1)
            before, moving = moving, twist_of(state[:, 0], state[:, 1], state[:, 2], kinematic[:, k + 1, 3], c)
            if dissipative:
                had, has = (_doubled_energy(m, c).clamp(min=STILL) for m in (before, moving))
                kept = torch.where((command[:, k, 1] <= 0.0) & (has > had), (had / has).sqrt(), 1.0)[:, None]
                state, moving = torch.cat([kept * state[:, :1], state[:, 1:]], dim=1), kept * moving
            out.append(moving)
        return torch.stack(out, dim=1)

    return run


def _doubled_energy(twist: Tensor, c: Frame) -> Tensor:
    return twist[:, 0] ** 2 + twist[:, 1] ** 2 + c.l_f * c.l_r * twist[:, 2] ** 2


def sparse_sum(xi: npt.NDArray[np.float64], exponents: Ints, c: Frame) -> Callable[[Tensor], Tensor]:
    """The sum of terms (B,) at x (B, 6): see `library.theta`; terms without a coefficient are left out."""
    import torch

    kept = np.flatnonzero(xi)
    most = max(1, int(exponents[kept].sum(axis=1).max(initial=1)))
    factors = [[j for j, n in enumerate(row) for _ in range(n)] for row in exponents[kept]]
    at = torch.tensor([[*f, *[len(FACTORS)] * (most - len(f))] for f in factors], dtype=torch.long).reshape(-1, most)
    coefficients = torch.tensor(xi[kept], dtype=torch.float32)

    def of(x: Tensor) -> Tensor:
        v, alpha_f, alpha_r, delta, u_s, u_m = x.unbind(1)
        rate = ((u_s - delta) / c.T_s).clamp(-c.d, c.d)
        named = {
            V: v, AF: alpha_f, AR: alpha_r, DELTA: delta, RATE: rate, ABS_AF: alpha_f.abs(), ABS_DELTA: delta.abs(),
            ABS_RATE: rate.abs(), THROTTLE: (u_m - c.follow * v).clamp(min=0.0), BRAKE: u_m.clamp(max=0.0),
            len(FACTORS): torch.ones_like(v),
        }  # fmt: skip
        q = torch.stack([named[j] for j in range(len(FACTORS) + 1)], dim=1)
        return q[:, at].prod(dim=2) @ coefficients

    return of


def sparse_sums(s: Sparse, c: Frame) -> Callable[[Tensor], Tensor]:
    """[v_f, alpha_f, alpha_r] (B, 3) one period later: see `bcid.models.kinematic.k_sindy.f_sindy`."""
    import torch

    each = [sparse_sum(xi, e, c) for xi, e in ((s.xi_v, s.speed), (s.xi_f, s.slip), (s.xi_r, s.slip))]
    return lambda x: torch.stack([f(x) for f in each], dim=1)
