"""The Newton-Euler car in libraries of arrays: numpy, torch and JAX, for one car and for many abreast."""

from typing import Any

import numpy as np

from bcid.aliases import Floats
from bcid.bench.equations import ElementaryFunctions, advance_period
from bcid.bench.timing import Work, require
from bcid.physics.car import Car

NUMPY = ElementaryFunctions(np.sin, np.cos, np.arctan, np.minimum, np.maximum, np.abs, np.where)


def roll_out_in_numpy(start: Floats, commands: Floats, car: Car, period_s: float) -> Work:
    """The rollout of one car by a loop of Python over numpy's scalars: the call that gives twists (N, 3)."""

    def rollout() -> Floats:
        state, out = tuple(start), np.empty((len(commands), 3))
        for k in range(len(commands)):
            state = advance_period(state, commands[k, 0], commands[k, 1], car, period_s, NUMPY)
            out[k] = state[:3]
        return out

    return rollout


def roll_out_many_in_numpy(starts: Floats, commands: Floats, car: Car, period_s: float) -> Work:
    """Rollouts of B cars by a loop over the periods, each of whose operations takes all cars: twists (B, N, 3)."""
    columns = commands.transpose(1, 2, 0).copy()

    def rollouts() -> Floats:
        state, out = tuple(starts.T.copy()), np.empty((len(columns), 3, len(starts)))
        for k in range(len(columns)):
            state = advance_period(state, columns[k, 0], columns[k, 1], car, period_s, NUMPY)
            out[k] = state[:3]
        return out.transpose(2, 0, 1)

    return rollouts


def roll_out_many_in_torch(starts: Floats, commands: Floats, car: Car, period_s: float) -> Work:
    """Rollouts of B cars by torch, operation by operation: the call that gives twists (B, N, 3)."""
    require("torch")
    import torch

    torch.set_num_threads(1)
    f = ElementaryFunctions(
        torch.sin, torch.cos, torch.arctan, lambda a, b: torch.clamp(a, max=b), lambda a, b: torch.clamp(a, min=b),
        torch.abs, torch.where,
    )  # fmt: skip
    begin, columns = tuple(torch.tensor(starts.T)), torch.tensor(commands.transpose(1, 2, 0).copy())

    def rollouts() -> Any:
        state, out = begin, []
        for k in range(len(columns)):
            state = advance_period(state, columns[k, 0], columns[k, 1], car, period_s, f)
            out.append(torch.stack(state[:3], dim=1))
        return torch.stack(out, dim=1).numpy()

    return rollouts


def roll_out_in_jax(start: Floats, commands: Floats, car: Car, period_s: float) -> Work:
    """The rollout by one `scan` that JAX compiles, in double precision: the call that gives the twists.

    `start` is (4,) and `commands` (N, 2) for one car, or (B, 4) and (B, N, 2) for B cars abreast.
    """
    require("jax")
    import jax
    import jax.numpy as jnp

    jax.config.update("jax_enable_x64", True)
    f = ElementaryFunctions(jnp.sin, jnp.cos, jnp.arctan, jnp.minimum, jnp.maximum, jnp.abs, jnp.where)

    def step(state: Any, u: Any) -> tuple[Any, Any]:
        state = advance_period(state, u[0], u[1], car, period_s, f)
        return state, jnp.stack(state[:3])

    compiled = jax.jit(lambda begin, columns: jax.lax.scan(step, begin, columns)[1])
    many = commands.ndim == 3
    columns = jnp.asarray(commands.transpose(1, 2, 0) if many else commands)
    begin = tuple(jnp.asarray(x) for x in start.T)

    def rollout() -> Floats:
        twists = np.asarray(compiled(begin, columns))
        return twists.transpose(2, 0, 1) if many else twists

    return rollout
