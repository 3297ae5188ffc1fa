"""Formulas as a graph of ONNX: of each node one operator, on a column that holds the numbers of a whole batch.

Columns (B, 1) are of double precision.  ONNX has no atan2, hypot and copysign, and onnxruntime no arc tangent in
double precision: these are replaced by other operations first, angles by the polynomial of `bcid.physics.elementary`.
The sign of a zero is not kept.  Networks are products of matrices in single precision, as in the model itself.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np

from bcid.export.graph import Graph, Node
from bcid.export.trace import Tracer
from bcid.models.network.mlp import MlpWeights
from bcid.physics.elementary import arctan_ratio

if TYPE_CHECKING:
    from onnx import GraphProto, NodeProto, TensorProto

OPERATORS = {
    "add": "Add", "sub": "Sub", "mul": "Mul", "div": "Div", "neg": "Neg", "abs": "Abs", "min": "Min", "max": "Max",
    "floor": "Floor", "sqrt": "Sqrt", "exp": "Exp", "sin": "Sin", "cos": "Cos", "tanh": "Tanh", "lt": "Less",
    "le": "LessOrEqual", "gt": "Greater", "ge": "GreaterOrEqual", "eq": "Equal", "and": "And", "or": "Or",
    "select": "Where",
}  # fmt: skip
"""The operator of ONNX that does each operation, of those that one does."""


def write_graph(
    name: str,
    inputs: Mapping[str, Sequence[str]],
    results: Mapping[str, Sequence[Node]],
    networks: Mapping[str, MlpWeights],
) -> GraphProto:
    """The graph `name` of ONNX that computes matrices (B, m) from matrices (B, n), for any B, all in double precision.

    `inputs` gives the matrices by name, each with the names of the inputs of formulas that its columns are; `results`
    the matrices to be computed, each with the nodes that its columns are.  The named constants of the formulas are
    constants of the same names.  `networks` holds the weights of the perceptrons that the nodes name.  It needs the
    library onnx.
    """
    from onnx import TensorProto, helper

    made = _GraphInTheMaking(networks)
    for matrix, names in inputs.items():
        made.add("Split", [matrix], names, axis=1, num_outputs=len(names))
    made.column = next(iter(inputs.values()))[0]
    nodes = iter(replace_operations([node for wanted in results.values() for node in wanted]))
    for matrix, wanted in results.items():
        made.stack([next(nodes) for _ in wanted], matrix)

    def describe(matrices: Mapping[str, Sequence[Any]]) -> list[Any]:
        return [helper.make_tensor_value_info(m, TensorProto.DOUBLE, ["B", len(c)]) for m, c in matrices.items()]

    return helper.make_graph(made.lines, name, describe(inputs), describe(results), list(made.constants.values()))


def replace_operations(results: Sequence[Node]) -> list[Node]:
    """The `results` as nodes of a new graph, in which no operation is left that has no operator in double precision."""
    graph = Graph()
    replaced = _other_operations(graph)
    made = dict[int, Any]()
    for node in results[0].graph.nodes_for(results):
        operands = [made[argument.place] for argument in node.arguments]
        match node.operation:
            case "input":
                made[node.place] = graph.input(node.name)
            case "parameter":
                made[node.place] = graph.parameter(node.name, float(node))
            case "constant":
                made[node.place] = float(node)
            case "network":
                network, _, output = node.name.rstrip("]").partition("[")
                stacked = tuple(graph.as_node(operand) for operand in operands)
                made[node.place] = graph.network_output(network, stacked, int(output))
            case operation if operation in replaced:
                made[node.place] = replaced[operation](*operands)
            case operation:
                made[node.place] = graph.operate(operation, *operands)
    return [graph.as_node(made[node.place]) for node in results]


def _other_operations(graph: Graph) -> dict[str, Callable[..., Any]]:
    """What stands for operations on nodes of `graph` that have no operator in double precision."""
    operate = graph.operate

    def copysign(size: Any, sign: Any) -> Any:
        size = operate("abs", size)
        return operate("select", operate("lt", sign, 0.0), operate("neg", size), size)

    def hypot(a: Any, b: Any) -> Any:
        return operate("sqrt", a * a + b * b)

    def atan2(y: Any, x: Any) -> Any:
        # at the origin, where the angle is 0, there is no ratio
        nowhere = operate("and", operate("eq", x, 0.0), operate("eq", y, 0.0))
        angle = ratio(y, operate("select", nowhere, 1.0, operate("abs", x)))
        return operate("select", operate("lt", x, 0.0), copysign(math.pi, y) - angle, angle)

    tracer = Tracer(graph, values={"math": SimpleNamespace(copysign=copysign)})
    # in place of the polynomial the tracer has the very operation that is to be replaced
    del tracer.copies[id(getattr(arctan_ratio, "py_func", arctan_ratio))]
    ratio = tracer.trace(arctan_ratio)
    return {"copysign": copysign, "hypot": hypot, "atan2": atan2, "atan": lambda x: ratio(x, 1.0)}


class _GraphInTheMaking:
    """Lines and constants of a graph of ONNX; results are called by their names."""

    def __init__(self, networks: Mapping[str, MlpWeights]) -> None:
        self.networks = networks
        self.lines: list[NodeProto] = []
        self.constants: dict[str, TensorProto] = {}
        self.names: dict[int, str] = {}  # of nodes that are computed, by place
        self.layers: dict[tuple[str, ...], list[str]] = {}  # columns of a network's outputs, by it and its inputs
        self.column = ""  # any input
        self.column_shape = ""  # its shape (B, 1), once it is asked for

    def add(self, operator: str, operands: Sequence[str], results: Sequence[str], **attributes: Any) -> str:
        """Add the line that computes `results` by an operator of ONNX; returns the name of the first."""
        from onnx import helper

        self.lines.append(helper.make_node(operator, operands, results, **attributes))
        return results[0]

    def constant(self, name: str, value: Any) -> str:
        """Add a constant, once; returns its name."""
        from onnx import numpy_helper

        if name not in self.constants:
            self.constants[name] = numpy_helper.from_array(np.array(value), name)
        return name

    def stack(self, nodes: Sequence[Node], matrix: str) -> str:
        """Add the `matrix` whose columns are `nodes`, of one graph, and what these are computed from."""
        for node in nodes[0].graph.nodes_for(nodes):
            if node.place not in self.names:
                self.names[node.place] = self._compute(node)
        return self.add("Concat", [self._column_of(node) for node in nodes], [matrix], axis=1)

    def _column_of(self, node: Node) -> str:
        """The column (B, 1) of a node that is computed; what depends on no input is a single number until here."""
        name = self.names[node.place]
        if node.value is None:
            return name
        self.column_shape = self.column_shape or self.add("Shape", [self.column], ["column_shape"])
        return self.add("Expand", [name, self.column_shape], [f"column_{len(self.lines)}"])

    def _compute(self, node: Node) -> str:
        """Add what computes one node; returns its name."""
        name = f"{node.operation}_{node.place}"
        operands = [self.names[argument.place] for argument in node.arguments]
        match node.operation:
            case "input":
                return node.name
            case "parameter" | "constant":
                return self.constant(node.name or name, float(node))
            case "network":
                network, _, output = node.name.rstrip("]").partition("[")
                return self._network_columns(network, node.arguments)[int(output)]
            case "ne":
                return self.add("Not", [self.add("Equal", operands, [f"eq_{node.place}"])], [name])
            case operation:
                return self.add(OPERATORS[operation], operands, [name])

    def _network_columns(self, network: str, inputs: Sequence[Node]) -> list[str]:
        """The columns of all outputs of a perceptron at `inputs`, added where they are asked for first."""
        key = (network, *(self.names[node.place] for node in inputs))
        if key not in self.layers:
            self.layers[key] = self._add_network(network, f"{network}_{len(self.layers)}", inputs)
        return self.layers[key]

    def _add_network(self, network: str, call: str, inputs: Sequence[Node]) -> list[str]:
        """Add y_mean + y_sd (W3 relu(W2 relu(W1 z + b1) + b2) + b3), z = (x - x_mean) / x_sd; `call` names its lines.

        The layers compute in single precision.
        """
        from onnx import TensorProto

        table = {k: self.constant(f"{network}_{k}", w) for k, w in self.networks[network]._asdict().items()}
        x = self.add("Concat", [self._column_of(node) for node in inputs], [f"{call}_x"], axis=1)
        x = self.add("Sub", [x, table["x_mean"]], [f"{call}_off_mean"])
        x = self.add("Div", [x, table["x_sd"]], [f"{call}_z"])
        x = self.add("Cast", [x], [f"{call}_h0"], to=TensorProto.FLOAT)
        for i in (1, 2, 3):
            x = self.add("Gemm", [x, table[f"W{i}"], table[f"b{i}"]], [f"{call}_h{i}"])
            x = self.add("Relu", [x], [f"{call}_r{i}"]) if i < 3 else x
        x = self.add("Cast", [x], [f"{call}_h"], to=TensorProto.DOUBLE)
        x = self.add("Mul", [x, table["y_sd"]], [f"{call}_off_y_mean"])
        x = self.add("Add", [x, table["y_mean"]], [f"{call}_y"])
        columns = [f"{call}_y{i}" for i in range(len(self.networks[network].y_mean))]
        self.add("Split", [x], columns, axis=1, num_outputs=len(columns))
        return columns
