"""Times of rollouts of our models beside numpy, casadi, torch, onnxruntime and pysindy."""

import itertools
import warnings
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from importlib.util import find_spec
from typing import Any

import numpy as np
import numpy.typing as npt

from bcid.aliases import Floats
from bcid.bench.equations import ElementaryFunctions, advance_period
from bcid.bench.limits import SPEED
from bcid.bench.timing import Timing, time_against_peers
from bcid.models import published
from bcid.models.kinematic.k_mlp import KMlp
from bcid.models.kinematic.state import KinematicCar
from bcid.models.network.mlp import MlpWeights
from bcid.models.newton_euler.model import NewtonEuler
from bcid.physics.car import Car
from bcid.physics.kinematics import body_twist
from bcid.physics.steering import steering_step

STEPS, PERIOD_S = 1100, 0.1
VEHICLES, AHEAD = 1000, 50
# Steps of pysindy's loop, whose time is taken as proportional.
SINDY_STEPS = 110
# Widths of the hidden layers, and the goal against torch.
NETWORKS = (((256, 128), SPEED.torch_network_256), ((128, 64), SPEED.torch_network_128))
START = np.array([1.0, 0.0, 0.0, 0.0])
NUMPY = ElementaryFunctions(np.sin, np.cos, np.arctan, np.minimum, np.maximum, np.abs, np.where)


def draw_commands(count: int, seed: int = 0) -> Floats:
    """Random commands [u_s, u_m] (count, 2), each held for 12 samples (1.2 s).

    u_s is the steering angle (rad); u_m is the reference speed (m/s), or where it is negative the share of braking.
    """
    rng, pieces = np.random.default_rng(seed), -(-count // 12)
    u_s, u_m = rng.normal(0.0, 0.8, pieces).clip(-2.0, 2.0), rng.choice([2.033, 2.033, 1.2, -0.4], pieces)
    return np.ascontiguousarray(np.repeat(np.column_stack([u_s, u_m]), 12, axis=0)[:count])


def time_newton_euler_rollout(repeats: int) -> Iterator[Timing]:
    """Yield timings of our compiled Newton-Euler rollout of 110 s against the same car written in numpy and in casadi.

    Times are medians of `repeats` turns; `difference` is the largest between the twists (m/s, rad/s).
    """
    car = published.newton_euler().car._replace(R_2=4.0)
    model, commands = NewtonEuler(car, PERIOD_S, {}), draw_commands(STEPS)
    rollout = model.scan(START, commands)[1]

    def numpy_loop() -> Floats:
        state, out = tuple(START), np.empty((STEPS, 3))
        for k in range(STEPS):
            state = advance_period(state, commands[k, 0], commands[k, 1], car, PERIOD_S, NUMPY)
            out[k] = state[:3]
        return out

    peers = {"numpy": (numpy_loop, SPEED.numpy_rollout, float(np.abs(numpy_loop() - rollout).max()))}
    if find_spec("casadi"):
        with_casadi = _casadi_rollout(car, commands)
        off = float(np.abs(with_casadi()[:, :3] - rollout).max())
        peers["casadi"] = (with_casadi, SPEED.casadi_rollout, off)
    yield from time_against_peers("rollout newton-euler", partial(model.scan, START, commands), peers, repeats)


def _casadi_rollout(car: Car, commands: Floats) -> Callable[[], Floats]:
    """Compile the Newton-Euler `car` in casadi; return a call that rolls it out under `commands` (STEPS, 2) from START.

    The call returns the states [v_x, v_y, omega, delta] (STEPS, 4), one after each period of 0.1 s.
    """
    import casadi as ca

    f = ElementaryFunctions(ca.sin, ca.cos, ca.atan, ca.fmin, ca.fmax, ca.fabs, ca.if_else)
    x, u = ca.SX.sym("x", 4), ca.SX.sym("u", 2)
    step = ca.Function(
        "step", [x, u], [ca.vertcat(*advance_period(tuple(ca.vertsplit(x)), u[0], u[1], car, PERIOD_S, f))]
    )
    loop = step.mapaccum("loop", STEPS)
    columns = ca.DM(commands.T)
    return lambda: np.asarray(loop(START, columns)).T


def time_many_newton_euler_rollouts(repeats: int) -> Iterator[Timing]:
    """Yield the timing of rollouts of 1000 Newton-Euler cars over 50 periods at once against torch, batched over cars.

    Model-predictive controllers that sample commands need such rollouts.  Times are medians of `repeats` turns.
    """
    import torch

    car = published.newton_euler().car._replace(R_2=4.0)
    model, rng = NewtonEuler(car, PERIOD_S, {}), np.random.default_rng(1)
    carries = rng.normal([1.0, 0.0, 0.0, 0.0], [0.3, 0.1, 0.3, 0.5], (VEHICLES, 4))
    commands = np.stack([draw_commands(AHEAD, seed) for seed in range(VEHICLES)])
    f = ElementaryFunctions(
        torch.sin, torch.cos, torch.arctan, lambda a, b: torch.clamp(a, max=b), lambda a, b: torch.clamp(a, min=b),
        torch.abs, torch.where,
    )  # fmt: skip
    starts, columns = tuple(torch.tensor(carries.T)), torch.tensor(commands.transpose(1, 2, 0).copy())

    def torch_eager() -> Any:
        state, out = starts, []
        for k in range(AHEAD):
            state = advance_period(state, columns[k, 0], columns[k, 1], car, PERIOD_S, f)
            out.append(torch.stack(state[:3], dim=1))
        return torch.stack(out, dim=1)

    off = float(np.abs(torch_eager().numpy() - model.scan_many(carries, commands)[1]).max())
    peers = {"torch eager": (torch_eager, SPEED.torch_many_rollouts, off)}
    path = f"rollouts newton-euler, {VEHICLES} × {AHEAD}"
    yield from time_against_peers(path, partial(model.scan_many, carries, commands), peers, repeats)


def time_k_mlp_rollout(repeats: int) -> Iterator[Timing]:
    """Yield timings of our compiled K-MLP rollout (a perceptron on the kinematic state) against torch and onnxruntime.

    The peers evaluate the network once a period in a Python loop.  Networks have the paper's two sizes, with random
    weights; times are medians of `repeats` turns.
    """
    for hidden, torch_goal in NETWORKS:
        weights, car = _draw_network_weights(hidden), published.k_sindy().car
        model, commands = KMlp(weights, car, {}), draw_commands(STEPS)
        rollout = model.scan(START, commands)[1]
        networks = {"torch eager": (_torch_network(weights), torch_goal)}
        if find_spec("onnxruntime") and find_spec("onnx"):
            networks["onnxruntime"] = (_onnx_network(weights), SPEED.onnxruntime_network)
        peers = {}
        for name, (network, goal) in networks.items():
            work = partial(_roll_out_network, network, commands, car)
            peers[name] = (work, goal, float(np.abs(work() - rollout).max()))
        path = f"rollout k-mlp {hidden[0]}-{hidden[1]}"
        yield from time_against_peers(path, partial(model.scan, START, commands), peers, repeats)


def _roll_out_network(network: Any, commands: Floats, c: KinematicCar) -> Floats:
    """Twists (N, 3) of a K-MLP under commands [u_s, u_m] (N, 2) from START, its `network` evaluated once a period.

    `network` maps [v_f, alpha_f, alpha_r, delta, u_s, u_m] (1, 6) to the next [v_f, alpha_f, alpha_r] (3,); `c` has the
    car's axle distances (m) and steering constants.
    """
    state, out, x = START.copy(), np.empty((len(commands), 3)), np.empty((1, 6), dtype=np.float32)
    for k, (u_s, u_m) in enumerate(commands):
        x[0, :4], x[0, 4], x[0, 5] = state, u_s, u_m
        state[:3] = network(x)
        state[0] = max(state[0], 0.0)
        state[3] = steering_step(state[3], u_s, c.T_s, c.d, c.period)
        out[k] = body_twist(state[0], state[3] + state[1], state[2], c.l_f, c.l_r)
    return out


def _draw_network_weights(hidden: tuple[int, int]) -> MlpWeights:
    """Random weights of a K-MLP's perceptron, 6 inputs to 3 outputs, with two hidden layers of the widths `hidden`.

    Outputs are scaled to plausible means and standard deviations, so that rollouts stay bounded.
    """
    rng, sizes = np.random.default_rng(0), (6, *hidden, 3)
    W1, W2, W3 = (rng.normal(0.0, n**-0.5, (n, m)).astype(np.float32) for n, m in itertools.pairwise(sizes))
    b1, b2, b3 = (rng.normal(0.0, 0.1, m).astype(np.float32) for m in sizes[1:])
    mean, sd = np.array([1.0, 0.0, 0.0]), np.array([0.3, 0.2, 0.1])
    return MlpWeights(np.zeros(6), np.ones(6), W1, b1, W2, b2, W3, b3, mean, sd)


def _torch_network(w: MlpWeights) -> Callable[[npt.NDArray[np.float32]], Any]:
    """Build the perceptron with weights `w` in torch; return the function from inputs (1, 6) to outputs (3,)."""
    import torch
    from torch import nn

    torch.set_num_threads(1)
    layers = []
    for W, b in ((w.W1, w.b1), (w.W2, w.b2), (w.W3, w.b3)):
        layers.append(nn.Linear(*W.shape))
        layers[-1].weight.data, layers[-1].bias.data = torch.tensor(W.T), torch.tensor(b)
    net = nn.Sequential(layers[0], nn.ReLU(), layers[1], nn.ReLU(), layers[2])
    mean, sd = (torch.tensor(a.astype(np.float32)) for a in (w.y_mean, w.y_sd))

    def evaluate(x: npt.NDArray[np.float32]) -> Any:
        with torch.no_grad():
            return (mean + sd * net(torch.from_numpy(x)))[0].numpy()

    return evaluate


def _onnx_network(w: MlpWeights) -> Callable[[npt.NDArray[np.float32]], Any]:
    """Build the perceptron with weights `w` for onnxruntime; return the function from inputs (1, 6) to outputs (3,)."""
    import onnxruntime
    from onnx import TensorProto, helper, numpy_helper

    arrays: dict[str, npt.NDArray[Any]] = {
        "W1": w.W1, "b1": w.b1, "W2": w.W2, "b2": w.b2, "W3": w.W3 * w.y_sd, "b3": w.b3 * w.y_sd + w.y_mean
    }  # fmt: skip
    nodes = [
        helper.make_node("Gemm", ["x", "W1", "b1"], ["h1"]), helper.make_node("Relu", ["h1"], ["r1"]),
        helper.make_node("Gemm", ["r1", "W2", "b2"], ["h2"]), helper.make_node("Relu", ["h2"], ["r2"]),
        helper.make_node("Gemm", ["r2", "W3", "b3"], ["y"]),
    ]  # fmt: skip
    graph = helper.make_graph(
        nodes, "net", [helper.make_tensor_value_info("x", TensorProto.FLOAT, [1, 6])],
        [helper.make_tensor_value_info("y", TensorProto.FLOAT, [1, 3])],
        [numpy_helper.from_array(a.astype(np.float32), name) for name, a in arrays.items()],
    )  # fmt: skip
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    made = helper.make_model(graph, ir_version=9, opset_imports=[helper.make_opsetid("", 17)])
    session = onnxruntime.InferenceSession(made.SerializeToString(), options, providers=["CPUExecutionProvider"])
    return lambda x: session.run(None, {"x": x})[0][0]


def time_k_sindy_rollout(repeats: int) -> Iterator[Timing]:
    """Yield the timing of our compiled K-SINDy rollout (sparse sums on the kinematic state) against pysindy's.

    pysindy's `predict` is called once a period with polynomials of degree 2, fitted to random data.  Both roll out
    SINDY_STEPS periods in `repeats` turns; times are extrapolated to STEPS periods.
    """
    import pysindy

    model, commands, rng = published.k_sindy(), draw_commands(STEPS)[:SINDY_STEPS], np.random.default_rng(0)
    x, u = rng.normal(0.0, 0.3, (400, 4)), rng.normal(0.0, 0.3, (400, 2))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        theirs = pysindy.DiscreteSINDy(feature_library=pysindy.PolynomialLibrary(2), optimizer=pysindy.STLSQ(0.0))
        theirs.fit(x, t=1, u=u)

    def pysindy_loop() -> None:
        state = np.zeros((1, 4))
        for k in range(SINDY_STEPS):
            state = np.clip(np.asarray(theirs.predict(state, u=commands[k : k + 1])), -1.0, 1.0)

    peers, longer = {"pysindy predict": (pysindy_loop, SPEED.pysindy_rollout, None)}, STEPS / SINDY_STEPS
    for row in time_against_peers("rollout k-sindy", partial(model.scan, START, commands), peers, repeats):
        yield replace(row, ours_ms=row.ours_ms * longer, peer_ms=row.peer_ms * longer)
