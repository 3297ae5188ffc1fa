"""The K-MLP in libraries of networks: torch, and onnxruntime called once a period or with the rollout in its graph."""

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from bcid.aliases import Floats
from bcid.bench.timing import Work, require
from bcid.models.kinematic.state import KinematicCar
from bcid.models.network.mlp import MlpWeights
from bcid.physics.kinematics import body_twist
from bcid.physics.steering import steering_step

OPSET, IR_VERSION = 17, 9
Network = Callable[[npt.NDArray[np.float32]], Any]


def roll_out_step_by_step(build: Callable[[MlpWeights], Network], w: MlpWeights, c: KinematicCar,
                          start: Floats, commands: Floats) -> Work:  # fmt: skip
    """The rollout of a K-MLP whose network, made by `build`, is called once a period: the call: twists (N, 3).

    The network maps [v_f, alpha_f, alpha_r, delta, u_s, u_m] (1, 6) to the next [v_f, alpha_f, alpha_r] (3,); `c` has
    the car's axle distances (m) and steering constants.
    """
    network = build(w)

    def rollout() -> Floats:
        state, out, x = start.copy(), np.empty((len(commands), 3)), np.empty((1, 6), dtype=np.float32)
        for k, (u_s, u_m) in enumerate(commands):
            x[0, :4], x[0, 4], x[0, 5] = state, u_s, u_m
            state[:3] = network(x)
            state[0] = max(state[0], 0.0)
            state[3] = steering_step(state[3], u_s, c.T_s, c.d, c.period)
            out[k] = body_twist(state[0], state[3] + state[1], state[2], c.l_f, c.l_r)
        return out

    return rollout


def build_torch_network(w: MlpWeights) -> Network:
    """Build the perceptron with weights `w` in torch; return the function from inputs (1, 6) to outputs (3,)."""
    require("torch")
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


def _weight_arrays(w: MlpWeights) -> dict[str, Any]:
    """The perceptron's weights by their names in the graphs, its outputs' scale and mean put into the last layer."""
    arrays: dict[str, Any] = {
        "W1": w.W1, "b1": w.b1, "W2": w.W2, "b2": w.b2, "W3": w.W3 * w.y_sd, "b3": w.b3 * w.y_sd + w.y_mean
    }  # fmt: skip
    return {name: a.astype(np.float32) for name, a in arrays.items()}


def _network_nodes(helper: Any) -> list[Any]:
    """The perceptron's nodes, from "x" (1, 6) to "y" (1, 3)."""
    return [
        helper.make_node("Gemm", ["x", "W1", "b1"], ["h1"]), helper.make_node("Relu", ["h1"], ["r1"]),
        helper.make_node("Gemm", ["r1", "W2", "b2"], ["h2"]), helper.make_node("Relu", ["h2"], ["r2"]),
        helper.make_node("Gemm", ["r2", "W3", "b3"], ["y"]),
    ]  # fmt: skip


def _start_session(graph: Any) -> Any:
    """A session of onnxruntime, of one thread, that runs `graph`."""
    import onnxruntime
    from onnx import helper

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    options.inter_op_num_threads = 1
    made = helper.make_model(graph, ir_version=IR_VERSION, opset_imports=[helper.make_opsetid("", OPSET)])
    return onnxruntime.InferenceSession(made.SerializeToString(), options, providers=["CPUExecutionProvider"])


def build_onnx_network(w: MlpWeights) -> Network:
    """Build the perceptron with weights `w` for onnxruntime; return the function from inputs (1, 6) to outputs (3,)."""
    require("onnx", "onnxruntime")
    from onnx import TensorProto, helper, numpy_helper

    graph = helper.make_graph(
        _network_nodes(helper), "net", [helper.make_tensor_value_info("x", TensorProto.FLOAT, [1, 6])],
        [helper.make_tensor_value_info("y", TensorProto.FLOAT, [1, 3])],
        [numpy_helper.from_array(a, name) for name, a in _weight_arrays(w).items()],
    )  # fmt: skip
    session = _start_session(graph)
    return lambda x: session.run(None, {"x": x})[0][0]


def roll_out_in_onnx(w: MlpWeights, c: KinematicCar, start: Floats, commands: Floats) -> Work:
    """The rollout of a K-MLP as one graph of onnxruntime with a Scan over the periods: the call: twists (N, 3).

    The steering angle, which follows the commands alone, is an input; all is computed in single precision.
    """
    require("onnx", "onnxruntime")
    from onnx import TensorProto, helper, numpy_helper

    node, info = helper.make_node, helper.make_tensor_value_info
    levers = {"l_f": c.l_f, "l_r": c.l_r, "wheelbase": c.l_f + c.l_r}
    arrays = _weight_arrays(w) | {k: np.array([[v]], dtype=np.float32) for k, v in levers.items()}
    zero, cuts = np.zeros((1, 1), dtype=np.float32), np.array([1, 1, 1], dtype=np.int64)
    arrays |= {"zero": zero, "cuts": cuts, "rank": np.array([1, -1], dtype=np.int64)}
    body = helper.make_graph(
        [
            node("Reshape", ["u", "rank"], ["row"]), node("Concat", ["state", "row"], ["x"], axis=1),
            *_network_nodes(helper),
            node("Split", ["y", "cuts"], ["v_raw", "alpha_f", "alpha_r"], axis=1),
            node("Max", ["v_raw", "zero"], ["v_f"]),
            node("Concat", ["v_f", "alpha_f", "alpha_r"], ["state_after"], axis=1),
            node("Reshape", ["after", "rank"], ["delta"]), node("Add", ["delta", "alpha_f"], ["beta_f"]),
            node("Cos", ["beta_f"], ["cos_f"]), node("Sin", ["beta_f"], ["sin_f"]), node("Tan", ["alpha_r"], ["tan_r"]),
            node("Mul", ["cos_f", "v_f"], ["v_x"]), node("Mul", ["sin_f", "v_f"], ["v_fy"]),
            node("Mul", ["v_x", "tan_r"], ["v_ry"]), node("Mul", ["l_r", "v_fy"], ["a"]),
            node("Mul", ["l_f", "v_ry"], ["b"]), node("Add", ["a", "b"], ["ab"]),
            node("Div", ["ab", "wheelbase"], ["v_y"]),
            node("Sub", ["v_fy", "v_ry"], ["d"]), node("Div", ["d", "wheelbase"], ["omega"]),
            node("Concat", ["v_x", "v_y", "omega"], ["twist"], axis=1),
        ],
        "period",
        [info("state", TensorProto.FLOAT, [1, 3]), info("u", TensorProto.FLOAT, [3]),
         info("after", TensorProto.FLOAT, [1])],
        [info("state_after", TensorProto.FLOAT, [1, 3]), info("twist", TensorProto.FLOAT, [1, 3])],
    )  # fmt: skip
    N = len(commands)
    graph = helper.make_graph(
        [node("Scan", ["start", "inputs", "deltas"], ["last", "twists"], body=body, num_scan_inputs=2)], "rollout",
        [info("start", TensorProto.FLOAT, [1, 3]), info("inputs", TensorProto.FLOAT, [N, 3]),
         info("deltas", TensorProto.FLOAT, [N, 1])],
        [info("last", TensorProto.FLOAT, [1, 3]), info("twists", TensorProto.FLOAT, [N, 1, 3])],
        [numpy_helper.from_array(a, name) for name, a in arrays.items()],
    )  # fmt: skip
    session, begin = _start_session(graph), start[None, :3].astype(np.float32)

    def rollout() -> Any:
        deltas = np.empty(N + 1)
        deltas[0] = start[3]
        for k in range(N):
            deltas[k + 1] = steering_step(deltas[k], commands[k, 0], c.T_s, c.d, c.period)
        inputs = np.column_stack([deltas[:-1], commands]).astype(np.float32)
        after = deltas[1:, None].astype(np.float32)
        return session.run(["twists"], {"start": begin, "inputs": inputs, "deltas": after})[0][:, 0]

    return rollout
