"""Rollouts of the models against numpy, casadi, torch, onnxruntime and pysindy."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from importlib.util import find_spec
from typing import Any

import numpy as np
import numpy.typing as npt

from bcid.aliases import Floats
from bcid.bench.equations import Functions, advance
from bcid.bench.timing import Row, compared
from bcid.models import published
from bcid.models.kinematic.frame import Frame
from bcid.models.kinematic.k_mlp import KMlp
from bcid.models.network.mlp import Weights
from bcid.models.newton_euler.model import NewtonEuler
from bcid.physics.car import Car
from bcid.physics.steering import steering_step

STEPS, PERIOD_S = 1100, 0.1
VEHICLES, AHEAD = 1000, 50
SINDY_STEPS = 110  # of pysindy's loop, whose time is taken as proportional
NETS = (((256, 128), 30.0), ((128, 64), 80.0))  # hidden layers, and the ratio to torch that is wanted


def commands(count: int, seed: int = 0) -> Floats:
    """Angles and speeds (count, 2) that hold for a second or so."""
    rng = np.random.default_rng(seed)
    held = -(-count // 12)
    drawn = np.column_stack([rng.normal(0.0, 0.8, held).clip(-2.0, 2.0), rng.choice([2.033, 2.033, 1.2, -0.4], held)])
    return np.ascontiguousarray(np.repeat(drawn, 12, axis=0)[:count])


def newton_euler(repeats: int) -> Iterator[Row]:
    """One car."""
    car = published.newton_euler().car._replace(R_2=4.0)
    model, driven, start = NewtonEuler(car, PERIOD_S, {}), commands(STEPS), np.array([1.0, 0.0, 0.0, 0.0])
    found = model.scan(start, driven)[1]

    def numpy_loop() -> Floats:
        state, out = tuple(start), np.empty((STEPS, 3))
        for k in range(STEPS):
            state = advance(state, driven[k, 0], driven[k, 1], car, PERIOD_S, NUMPY)
            out[k] = state[:3]
        return out

    peers = {"numpy": (numpy_loop, 100.0, float(np.abs(numpy_loop() - found).max()))}
    if find_spec("casadi"):
        with_casadi = _casadi(car, start, driven)
        peers["casadi"] = (with_casadi, 3.0, float(np.abs(with_casadi()[:, :3] - found).max()))
    yield from compared("rollout newton-euler", lambda: model.scan(start, driven), peers, repeats)


NUMPY = Functions(np.sin, np.cos, np.arctan, np.minimum, np.maximum, np.abs, np.where)


def _casadi(car: Car, start: Floats, driven: Floats) -> Any:
    """The rollout in casadi's virtual machine: one step, mapped and accumulated."""
    import casadi as ca

    f = Functions(ca.sin, ca.cos, ca.atan, ca.fmin, ca.fmax, ca.fabs, ca.if_else)
    x, u = ca.SX.sym("x", 4), ca.SX.sym("u", 2)
    step = ca.Function("step", [x, u], [ca.vertcat(*advance(tuple(ca.vertsplit(x)), u[0], u[1], car, PERIOD_S, f))])
    loop = step.mapaccum("loop", STEPS)
    columns = ca.DM(driven.T)
    return lambda: np.asarray(loop(start, columns)).T


def many_newton_eulers(repeats: int) -> Iterator[Row]:
    """A thousand cars, as a sampling controller needs them."""
    import torch

    car = published.newton_euler().car._replace(R_2=4.0)
    model, rng = NewtonEuler(car, PERIOD_S, {}), np.random.default_rng(1)
    carries = rng.normal([1.0, 0.0, 0.0, 0.0], [0.3, 0.1, 0.3, 0.5], (VEHICLES, 4))
    driven = np.stack([commands(AHEAD, seed) for seed in range(VEHICLES)])
    f = Functions(torch.sin, torch.cos, torch.arctan, _least, _greatest, torch.abs, torch.where)
    starts, of = tuple(torch.tensor(carries.T)), torch.tensor(driven.transpose(1, 2, 0).copy())

    def torch_eager() -> Any:
        state, out = starts, []
        for k in range(AHEAD):
            state = advance(state, of[k, 0], of[k, 1], car, PERIOD_S, f)
            out.append(torch.stack(state[:3], dim=1))
        return torch.stack(out, dim=1)

    off = float(np.abs(torch_eager().numpy() - model.scan_many(carries, driven)[1]).max())
    peers = {"torch eager": (torch_eager, 10.0, off)}
    path = f"rollouts newton-euler, {VEHICLES} × {AHEAD}"
    yield from compared(path, lambda: model.scan_many(carries, driven), peers, repeats)


def _least(a: Any, b: Any) -> Any:
    import torch

    return torch.clamp(a, max=b)


def _greatest(a: Any, b: Any) -> Any:
    import torch

    return torch.clamp(a, min=b)


def perceptrons(repeats: int) -> Iterator[Row]:
    """K-MLP with the paper's two sizes: the network alone differs, the servo and the rest are numpy's for the peers."""
    for hidden, goal in NETS:
        weights = _weights(hidden)
        model = KMlp(weights, published.k_sindy().frame, {})
        driven, start = commands(STEPS), np.array([1.0, 0.0, 0.0, 0.0])
        found, c = model.scan(start, driven)[1], model.frame
        nets = {"torch eager": (_torch_net(weights), goal)}
        if find_spec("onnxruntime") and find_spec("onnx"):
            nets["onnxruntime"] = (_onnx_net(weights), 5.0)
        peers = {}
        for name, (net, wanted) in nets.items():
            off = float(np.abs(_driven_by(net, start, driven, c) - found).max())
            peers[name] = (_work(net, start, driven, c), wanted, off)
        yield from compared(f"rollout k-mlp {hidden[0]}-{hidden[1]}", _scan(model, start, driven), peers, repeats)


def _work(net: Any, start: Floats, driven: Floats, c: Frame) -> Any:
    return lambda: _driven_by(net, start, driven, c)


def _scan(model: Any, start: Floats, driven: Floats) -> Any:
    return lambda: model.scan(start, driven)


def _driven_by(net: Any, start: Floats, driven: Floats, c: Frame) -> Floats:
    """A kinematic rollout with a network that is called step by step."""
    from bcid.physics.kinematics import body_twist

    state, out, x = start.copy(), np.empty((len(driven), 3)), np.empty((1, 6), dtype=np.float32)
    for k, (u_s, u_m) in enumerate(driven):
        x[0, :4], x[0, 4], x[0, 5] = state, u_s, u_m
        state[:3] = net(x)
        state[0] = max(state[0], 0.0)
        state[3] = steering_step(state[3], u_s, c.T_s, c.d, c.period)
        out[k] = body_twist(state[0], state[3] + state[1], state[2], c.l_f, c.l_r)
    return out


def _weights(hidden: tuple[int, int]) -> Weights:
    """A network that stays near a steady drive."""
    rng, sizes = np.random.default_rng(0), (6, *hidden, 3)
    W1, W2, W3 = (rng.normal(0.0, n**-0.5, (n, m)).astype(np.float32) for n, m in itertools.pairwise(sizes))
    b1, b2, b3 = (rng.normal(0.0, 0.1, m).astype(np.float32) for m in sizes[1:])
    mean, sd = np.array([1.0, 0.0, 0.0]), np.array([0.3, 0.2, 0.1])
    return Weights(np.zeros(6), np.ones(6), W1, b1, W2, b2, W3, b3, mean, sd)


def _torch_net(w: Weights) -> Any:
    import torch
    from torch import nn

    torch.set_num_threads(1)
    layers = []
    for W, b in ((w.W1, w.b1), (w.W2, w.b2), (w.W3, w.b3)):
        layers.append(nn.Linear(*W.shape))
        layers[-1].weight.data, layers[-1].bias.data = torch.tensor(W.T), torch.tensor(b)
    net = nn.Sequential(layers[0], nn.ReLU(), layers[1], nn.ReLU(), layers[2])
    mean, sd = (torch.tensor(a.astype(np.float32)) for a in (w.y_mean, w.y_sd))

    def of(x: npt.NDArray[np.float32]) -> Any:
        with torch.no_grad():
            return (mean + sd * net(torch.from_numpy(x)))[0].numpy()

    return of


def _onnx_net(w: Weights) -> Any:
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


def sparse_sum(repeats: int) -> Iterator[Row]:
    """K-SINDy; pysindy's own model has as many terms (all products of two of six variables), not the same ones."""
    import warnings

    import pysindy

    model = published.k_sindy()
    driven, start = commands(STEPS), np.array([1.0, 0.0, 0.0, 0.0])
    rng = np.random.default_rng(0)
    x, u = rng.normal(0.0, 0.3, (400, 4)), rng.normal(0.0, 0.3, (400, 2))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        theirs = pysindy.DiscreteSINDy(feature_library=pysindy.PolynomialLibrary(2), optimizer=pysindy.STLSQ(0.0))
        theirs.fit(x, t=1, u=u)

    def pysindy_loop() -> None:
        state = np.zeros((1, 4))
        for k in range(SINDY_STEPS):
            state = np.clip(np.asarray(theirs.predict(state, u=driven[k : k + 1])), -1.0, 1.0)

    short = driven[:SINDY_STEPS]
    peers = {"pysindy predict": (pysindy_loop, 10_000.0, None)}
    for row in compared("rollout k-sindy", lambda: model.scan(start, short), peers, repeats):
        times = STEPS / SINDY_STEPS
        yield Row(row.path, row.peer, row.ours_ms * times, row.peer_ms * times, row.goal, row.difference)
