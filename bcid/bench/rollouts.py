"""Times of rollouts of our models beside C, casadi, JAX, numpy, torch, onnxruntime and pysindy."""

import itertools
import warnings
from collections.abc import Iterator
from dataclasses import replace
from functools import partial

import numpy as np

from bcid.aliases import Floats
from bcid.bench import car_in_arrays, car_in_c, networks
from bcid.bench.limits import SPEED
from bcid.bench.timing import Skipped, TimedPeer, Timing, Work, require, time_against_peers
from bcid.models import published
from bcid.models.interface import Model
from bcid.models.kinematic.k_mlp import KMlp
from bcid.models.kinematic.k_sindy import KSindy
from bcid.models.limits import LIMITS
from bcid.models.network.mlp import MlpWeights
from bcid.models.newton_euler.model import NewtonEuler

STEPS, PERIOD_S = 1100, 0.1
VEHICLES, AHEAD = 1000, 50
# Steps of pysindy's loop, whose time is taken as proportional.
SINDY_STEPS = 110
# Widths of the hidden layers, and the goal against torch.
NETWORKS = (((256, 128), SPEED.torch_network_256), ((128, 64), SPEED.torch_network_128))
START = np.array([1.0, 0.0, 0.0, 0.0])
EXACT, SINGLE = SPEED.max_difference, LIMITS.single_precision_error


def draw_commands(count: int, seed: int = 0) -> Floats:
    """Random commands [u_s, u_m] (count, 2), each held for 12 samples (1.2 s).

    u_s is the steering angle (rad); u_m is the reference speed (m/s), or where it is negative the share of braking.
    """
    rng, pieces = np.random.default_rng(seed), -(-count // 12)
    u_s, u_m = rng.normal(0.0, 0.8, pieces).clip(-2.0, 2.0), rng.choice([2.033, 2.033, 1.2, -0.4], pieces)
    return np.ascontiguousarray(np.repeat(np.column_stack([u_s, u_m]), 12, axis=0)[:count])


def time_newton_euler_rollout(repeats: int) -> Iterator[Timing | Skipped]:
    """Yield timings of our compiled Newton-Euler rollout of 110 s against the same car written for other tools.

    Times are medians of `repeats` turns; differences are the largest between the twists (m/s, rad/s).
    """
    car = published.newton_euler().car._replace(R_2=4.0)
    model, commands = NewtonEuler(car, PERIOD_S, {}), draw_commands(STEPS)
    task = START, commands, car, PERIOD_S
    peers = {
        "C by hand": TimedPeer(partial(car_in_c.roll_out_in_c, *task), SPEED.c_rollout, EXACT),
        "C by casadi": TimedPeer(partial(car_in_c.roll_out_in_generated_c, *task), SPEED.casadi_c_rollout, EXACT),
        "casadi": TimedPeer(partial(car_in_c.roll_out_by_casadi, *task), SPEED.casadi_rollout, EXACT),
        "JAX scan": TimedPeer(partial(car_in_arrays.roll_out_in_jax, *task), SPEED.jax_rollout, EXACT),
        "numpy": TimedPeer(partial(car_in_arrays.roll_out_in_numpy, *task), SPEED.numpy_rollout, EXACT),
    }
    yield from time_against_peers("rollout newton-euler", partial(_twists, model, commands), peers, repeats)


def time_many_newton_euler_rollouts(repeats: int) -> Iterator[Timing | Skipped]:
    """Yield timings of rollouts of 1000 Newton-Euler cars over 50 periods at once, in double and single precision.

    Model-predictive controllers that sample commands need such rollouts.  Times are medians of `repeats` turns.
    """
    car = published.newton_euler().car._replace(R_2=4.0)
    model, rng = NewtonEuler(car, PERIOD_S, {}), np.random.default_rng(1)
    carries = rng.normal([1.0, 0.0, 0.0, 0.0], [0.3, 0.1, 0.3, 0.5], (VEHICLES, 4))
    commands = np.stack([draw_commands(AHEAD, seed) for seed in range(VEHICLES)])
    task, path = (carries, commands, car, PERIOD_S), f"rollouts newton-euler, {VEHICLES} × {AHEAD}"

    def double() -> Floats:
        return model.scan_many(carries, commands)[1]

    def single() -> Floats:
        return model.scan_many_single(carries, commands)[1]

    in_c = car_in_c.roll_out_many_in_c
    peers = {
        "C by hand": TimedPeer(partial(in_c, *task, "double"), SPEED.c_many_rollouts, EXACT),
        "numpy": TimedPeer(partial(car_in_arrays.roll_out_many_in_numpy, *task), SPEED.numpy_many_rollouts, EXACT),
        "torch eager": TimedPeer(
            partial(car_in_arrays.roll_out_many_in_torch, *task), SPEED.torch_many_rollouts, EXACT
        ),
        "JAX scan": TimedPeer(partial(car_in_arrays.roll_out_in_jax, *task), SPEED.jax_many_rollouts, EXACT),
    }
    yield from time_against_peers(path, double, peers, repeats)
    single_peers = {
        "ours, double": TimedPeer(lambda: double, SPEED.single_over_double, SINGLE),
        "C by hand, float": TimedPeer(partial(in_c, *task, "float"), SPEED.c_many_single_rollouts, SINGLE),
    }
    yield from time_against_peers(f"{path}, single precision", single, single_peers, repeats)


def time_k_mlp_rollout(repeats: int) -> Iterator[Timing | Skipped]:
    """Yield timings of our compiled K-MLP rollout (a perceptron on the kinematic state) against torch and onnxruntime.

    They evaluate the network once a period in a Python loop; onnxruntime also runs the whole rollout as one graph.
    Networks have the paper's two sizes, with random weights; times are medians of `repeats` turns.
    """
    for hidden, torch_goal in NETWORKS:
        weights, car = _draw_network_weights(hidden), published.k_sindy().car
        model, commands = KMlp(weights, car, {}), draw_commands(STEPS)
        stepwise, task = networks.roll_out_step_by_step, (weights, car, START, commands)
        peers = {
            "torch eager": TimedPeer(partial(stepwise, networks.build_torch_network, *task), torch_goal, SINGLE),
            "onnxruntime": TimedPeer(
                partial(stepwise, networks.build_onnx_network, *task), SPEED.onnxruntime_network, SINGLE
            ),
            "onnxruntime, Scan": TimedPeer(partial(networks.roll_out_in_onnx, *task), SPEED.onnxruntime_scan, SINGLE),
        }
        path, ours = f"rollout k-mlp {hidden[0]}-{hidden[1]}", partial(_twists, model, commands)
        yield from time_against_peers(path, ours, peers, repeats)


def _twists(model: Model, commands: Floats) -> Floats:
    """Twists (N, 3) that `model` rolls out from START under `commands` (N, 2)."""
    return model.scan(START, commands)[1]


def _draw_network_weights(hidden: tuple[int, int]) -> MlpWeights:
    """Random weights of a K-MLP's perceptron, 6 inputs to 3 outputs, with two hidden layers of the widths `hidden`.

    Outputs are scaled to plausible means and standard deviations, so that rollouts stay bounded.
    """
    rng, sizes = np.random.default_rng(0), (6, *hidden, 3)
    W1, W2, W3 = (rng.normal(0.0, n**-0.5, (n, m)).astype(np.float32) for n, m in itertools.pairwise(sizes))
    b1, b2, b3 = (rng.normal(0.0, 0.1, m).astype(np.float32) for m in sizes[1:])
    mean, sd = np.array([1.0, 0.0, 0.0]), np.array([0.3, 0.2, 0.1])
    return MlpWeights(np.zeros(6), np.ones(6), W1, b1, W2, b2, W3, b3, mean, sd)


def time_k_sindy_rollout(repeats: int) -> Iterator[Timing | Skipped]:
    """Yield timings of our compiled K-SINDy rollout (sparse sums on the kinematic state) against numpy and pysindy.

    pysindy's `predict` is called once a period with polynomials of degree 2, fitted to random data, so that results
    are not compared; it rolls out SINDY_STEPS periods, and its time is extrapolated to STEPS periods.
    """
    model, commands = published.k_sindy(), draw_commands(STEPS)
    numpy_loop = {"numpy": TimedPeer(partial(_roll_out_sums_in_numpy, model, commands), SPEED.numpy_sindy, EXACT)}
    ours = partial(_twists, model, commands)
    yield from time_against_peers("rollout k-sindy", ours, numpy_loop, repeats, SPEED.longest_sindy_ms)
    short, longer = commands[:SINDY_STEPS], STEPS / SINDY_STEPS
    peers = {"pysindy predict": TimedPeer(partial(_roll_out_by_pysindy, short), SPEED.pysindy_rollout)}
    for row in time_against_peers("rollout k-sindy", ours, peers, repeats):
        yield replace(row, peer_ms=row.peer_ms * longer) if isinstance(row, Timing) else row


def _roll_out_sums_in_numpy(model: KSindy, commands: Floats) -> Work:
    """The rollout of a K-SINDy by a loop over its coefficients in numpy: the call that gives twists (N, 3)."""
    s, c = model.sparse, model.car
    terms = np.vstack([s.speed, s.slip]).astype(float)
    n = len(s.speed)
    Xi = np.zeros((3, len(terms)))
    Xi[0, :n], Xi[1, n:], Xi[2, n:] = s.xi_v, s.xi_f, s.xi_r
    used = Xi.any(axis=0)
    terms, Xi = terms[used], Xi[:, used]

    def rollout() -> Floats:
        (v, a_f, a_r, delta), out = START, np.empty((len(commands), 3))
        for k, (u_s, u_m) in enumerate(commands):
            rate = min(max((u_s - delta) / c.T_s, -c.d), c.d)
            q = np.array([v, a_f, a_r, delta, rate, abs(a_f), abs(delta), abs(rate), max(0.0, u_m - v), min(0.0, u_m)])
            v, a_f, a_r = Xi @ np.prod(q**terms, axis=1)
            v = max(v, 0.0)
            miss = u_s - delta
            ramp = min(max(abs(miss) / c.d - c.T_s, 0.0), c.period)
            miss -= np.copysign(c.d * ramp, miss)
            delta = u_s - miss * np.exp((ramp - c.period) / c.T_s)
            v_x, v_fy = v * np.cos(delta + a_f), v * np.sin(delta + a_f)
            v_ry = v_x * np.tan(a_r)
            out[k] = v_x, (c.l_r * v_fy + c.l_f * v_ry) / (c.l_f + c.l_r), (v_fy - v_ry) / (c.l_f + c.l_r)
        return out

    return rollout


def _roll_out_by_pysindy(commands: Floats) -> Work:
    """A loop over pysindy's `predict` under `commands` (N, 2), with equations fitted to random data."""
    require("pysindy")
    import pysindy

    rng = np.random.default_rng(0)
    x, u = rng.normal(0.0, 0.3, (400, 4)), rng.normal(0.0, 0.3, (400, 2))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        theirs = pysindy.DiscreteSINDy(feature_library=pysindy.PolynomialLibrary(2), optimizer=pysindy.STLSQ(0.0))
        theirs.fit(x, t=1, u=u)

    def rollout() -> None:
        state = np.zeros((1, 4))
        for k in range(len(commands)):
            state = np.clip(np.asarray(theirs.predict(state, u=commands[k : k + 1])), -1.0, 1.0)

    return rollout
