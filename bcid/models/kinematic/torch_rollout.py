"""The kinematic models' rollouts in torch, for training: the same equations as `bcid.models.kinematic.state`."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from bcid.aliases import Floats, Ints
from bcid.models.fitting.windows import Windows
from bcid.models.kinematic.library import ABS_AF, ABS_DELTA, ABS_RATE, AF, AR, BRAKE, DELTA, FACTORS, RATE, THROTTLE, V
from bcid.models.kinematic.sparse_sum import SparseEquations
from bcid.models.kinematic.state import SLIP_LIMIT, KinematicCar, follow_commands
from bcid.models.network.training import Network, RolloutFunction

if TYPE_CHECKING:
    from torch import Tensor


MIN_ENERGY = 1e-8  # m^2/s^2, below which the root of a doubled energy has no useful slope


def simulate_steering(stretches: Windows, c: KinematicCar) -> Windows:
    """Copy the stretches, replacing estimated steering angles after each start by those that the servo's law predicts.

    The law, as in a rollout, is a first-order lag with the time constant T_s and the rate limit d of `c`, under the
    recorded commands.
    """
    kinematic = stretches.kinematic.copy()
    for b in range(stretches.stretch_count):
        for k in range(stretches.steps):
            kinematic[b, k + 1, 3] = follow_commands(kinematic[b, k, 3], stretches.parts[b], k, c)
    return stretches._replace(kinematic=kinematic)


def _kinematic_twist_in_torch(state: Tensor, delta: Tensor, c: KinematicCar) -> Tensor:
    """Twists [v_x, v_y, yaw rate] (B, 3) at states [v_f, alpha_f, alpha_r] (B, 3), steering `delta` (B,), in torch."""
    import torch

    v_f, alpha_f, alpha_r = state.unbind(1)
    beta_f, beta_r = delta + alpha_f, alpha_r.clamp(-SLIP_LIMIT, SLIP_LIMIT)
    v_x, v_fy = torch.cos(beta_f) * v_f, torch.sin(beta_f) * v_f
    v_ry, wheelbase = v_x * torch.tan(beta_r), c.l_f + c.l_r
    return torch.stack([v_x, (c.l_r * v_fy + c.l_f * v_ry) / wheelbase, (v_fy - v_ry) / wheelbase], dim=1)


def build_kinematic_rollout(
    c: KinematicCar, next_kinematics: Callable[[Network, Tensor], Tensor], dissipative: bool = False
) -> RolloutFunction:
    """Build a differentiable torch function that predicts the twists (B, S, 3) of a kinematic model over B stretches.

    `next_kinematics` maps a network and [v_f, alpha_f, alpha_r, delta, u_s, u_m] (B, 6) to [v_f, alpha_f, alpha_r] a
    period later.  If `dissipative`, v_f is lowered where a step with u_m <= 0 would gain kinetic energy (`cap_energy`).
    """
    import torch

    def roll_out(network: Network, twist: Tensor, kinematic: Tensor, command: Tensor) -> Tensor:
        state, out = kinematic[:, 0, :3], []
        moving = _kinematic_twist_in_torch(state, kinematic[:, 0, 3], c)
        for k in range(kinematic.shape[1] - 1):
            x = torch.cat([state, kinematic[:, k, 3:], command[:, k]], dim=1)
            following = next_kinematics(network, x)
            state = torch.cat([following[:, :1].clamp(min=0.0), following[:, 1:]], dim=1)
            before, moving = moving, _kinematic_twist_in_torch(state, kinematic[:, k + 1, 3], c)
            if dissipative:
                squares = [(m**2).unbind(1) for m in (before, moving)]
                had, has = ((x + y + c.l_f * c.l_r * w).clamp(min=MIN_ENERGY) for x, y, w in squares)
                kept = torch.where((command[:, k, 1] <= 0.0) & (has > had), (had / has).sqrt(), 1.0)[:, None]
                state, moving = torch.cat([kept * state[:, :1], state[:, 1:]], dim=1), kept * moving
            out.append(moving)
        return torch.stack(out, dim=1)

    return roll_out


def _build_sparse_sum(xi: Floats, exponents: Ints, c: KinematicCar) -> Callable[[Tensor], Tensor]:
    """Build a torch function from [v_f, alpha_f, alpha_r, delta, u_s, u_m] (B, 6) to one K-SINDy equation's sum (B,).

    `xi` (n,) are the coefficients, and `exponents` (n, 10) the powers of the ten `FACTORS` in each term.
    """
    import torch

    kept = np.flatnonzero(xi)
    most = max(1, int(exponents[kept].sum(axis=1).max(initial=1)))
    factors = [[j for j, n in enumerate(row) for _ in range(n)] for row in exponents[kept]]
    at = torch.tensor([[*f, *[len(FACTORS)] * (most - len(f))] for f in factors], dtype=torch.long).reshape(-1, most)
    coefficients = torch.tensor(xi[kept], dtype=torch.float32)

    def sum_terms(x: Tensor) -> Tensor:
        v, alpha_f, alpha_r, delta, u_s, u_m = x.unbind(1)
        rate = ((u_s - delta) / c.T_s).clamp(-c.d, c.d)
        named = {
            V: v, AF: alpha_f, AR: alpha_r, DELTA: delta, RATE: rate, ABS_AF: alpha_f.abs(), ABS_DELTA: delta.abs(),
            ABS_RATE: rate.abs(), THROTTLE: (u_m - c.follow * v).clamp(min=0.0), BRAKE: u_m.clamp(max=0.0),
            len(FACTORS): torch.ones_like(v),
        }  # fmt: skip
        q = torch.stack([named[j] for j in range(len(FACTORS) + 1)], dim=1)
        return q[:, at].prod(dim=2) @ coefficients

    return sum_terms


def build_f_sindy(s: SparseEquations, c: KinematicCar) -> Callable[[Tensor], Tensor]:
    """Build a torch function for one period of K-SINDy: (B, 6) to the next [v_f, alpha_f, alpha_r] (B, 3).

    Its input is [v_f, alpha_f, alpha_r, delta, u_s, u_m] in SI units.
    """
    import torch

    each = [_build_sparse_sum(xi, e, c) for xi, e in ((s.xi_v, s.speed), (s.xi_f, s.slip), (s.xi_r, s.slip))]
    return lambda x: torch.stack([f(x) for f in each], dim=1)
