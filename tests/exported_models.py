"""Small models of every kind, made without a fit, for tests of what is exported."""

from __future__ import annotations

import functools
import importlib.util
import math
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from bcid.documents.export import ExportDocument
from bcid.effects.constants import Constants
from bcid.effects.entry import Effect
from bcid.effects.table import ENTRIES
from bcid.export.exported import Exported, export_model
from bcid.export.graph import OPERATIONS, Node
from bcid.export.write import write_export
from bcid.models.interface import Model
from bcid.models.kinematic import library
from bcid.models.kinematic.k_mlp import KMlp
from bcid.models.kinematic.k_sindy import KSindy
from bcid.models.kinematic.k_sindy_mlp import KSindyMlp
from bcid.models.kinematic.sparse_sum import SparseEquations
from bcid.models.kinematic.state import KinematicCar
from bcid.models.network.mlp import MlpWeights
from bcid.models.network.narx_mlp import INPUTS, NarxMlp
from bcid.models.newton_euler.augmented import AugmentedNewtonEuler
from bcid.models.newton_euler.linear import NewtonEulerLinear
from bcid.models.newton_euler.model import NewtonEuler
from bcid.physics.car import Car, typical_inertia_and_tyres

PERIOD_S = 0.02
CAR = Car(
    m=200.0, T_s=0.1, d=3.0, F_m_max=300.0, K_t=200.0, K_b=100.0, l_f=0.6, l_r=0.5, R_1=3.0, R_2=1.0, v_0=0.5,
    **typical_inertia_and_tyres(200.0, 0.6, 0.5, 1.0, 5.0, 4.0),
)  # fmt: skip
FRAME = KinematicCar(0.6, 0.5, 0.1, 3.0, PERIOD_S)


def random_weights(inputs: int, seed: int = 1) -> MlpWeights:
    rng = np.random.default_rng(seed)
    shapes = [(inputs, 17), (17, 9), (9, 3)]
    layers = [rng.normal(0.0, n**-0.5, (n, m)).astype(np.float32) for n, m in shapes]
    biases = [rng.normal(0.0, 0.1, m).astype(np.float32) for _, m in shapes]
    (W1, W2, W3), (b1, b2, b3) = layers, biases
    return MlpWeights(
        rng.normal(0.0, 0.2, inputs), rng.uniform(0.5, 2.0, inputs), W1, b1, W2, b2, W3, b3,
        np.array([0.6, 0.0, 0.0]), np.array([0.1, 0.05, 0.05]),
    )  # fmt: skip


def k_sindy() -> KSindy:
    rng = np.random.default_rng(2)
    xi_v, xi_f, xi_r = (rng.normal(0.0, 0.004, n) for n in (len(library.SPEED_TERMS), *2 * [len(library.SLIP_TERMS)]))
    xi_v[4], xi_f[0], xi_r[1], xi_v[7], xi_f[3] = 0.99, 0.9, 0.9, 0.0, 0.0
    return KSindy(SparseEquations(xi_v, xi_f, xi_r, library.SPEED_TERMS, library.SLIP_TERMS), FRAME, {})


def augmented_car(effects: dict[str, float], car: Car = CAR) -> AugmentedNewtonEuler:
    return AugmentedNewtonEuler(car, effects, Constants(), 1.2, 600.0, PERIOD_S, {})


def typical(effect: Effect) -> dict[str, float]:
    """An effect's parameters at which it shows: its size, a place near the start, a time during the drive."""
    return {
        field: p.size if not p.is_place else (1.0 if p.unit == "s" else 0.5)
        for field, p in zip(effect.fields, effect.parameters, strict=True)
    }


SEVERAL = {
    "steering_delay__tau": 0.031, "steering_lag__tau": 0.04, "steering_backlash__b": 0.02, "motor_delay__tau": 0.05,
    "motor_lag__tau": 0.1, "steering_drag__k": 20.0, "marker_offset__d_x": 0.1, "marker_offset__d_y": 0.02,
}  # fmt: skip

MODELS: dict[str, Model] = {
    "newton-euler": NewtonEuler(CAR, PERIOD_S, {}),
    "newton-euler-linear": NewtonEulerLinear(CAR, 1.0, PERIOD_S),
    "narx-mlp": NarxMlp(random_weights(INPUTS), PERIOD_S, {}),
    "k-mlp": KMlp(random_weights(6), FRAME, {}),
    "k-sindy": k_sindy(),
    "k-sindy-mlp": KSindyMlp(k_sindy(), random_weights(6)._replace(y_mean=np.zeros(3)), {}),
    "newton-euler-augmented": augmented_car(SEVERAL),
}  # fmt: skip


@functools.cache
def make_export(name: str) -> Exported:
    """The model of this name as it is exported, made once for all tests: its drive cannot be written to."""
    e = export_model(MODELS[name], "0" * 64, None)
    e.vectors.commands.setflags(write=False)
    e.vectors.twists.setflags(write=False)
    return e


def no_progress(share: float, text: str) -> None:
    pass


def written(e: Exported, formats: list[str], folder: Path) -> ExportDocument:
    return write_export(e, formats, folder, lambda path: False, no_progress)


def load_module(path: Path) -> Any:
    """A module from a file, with those beside it."""
    sys.path.insert(0, str(path.parent))
    try:
        spec = importlib.util.spec_from_file_location(path.stem, path)
        assert spec is not None
        assert spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
    finally:
        sys.path.remove(str(path.parent))
    return module


def all_effects_but(*left_out: str) -> dict[str, float]:
    """The parameters of all effects at once, at which each shows."""
    return {f: x for name, e in ENTRIES.items() if name not in left_out for f, x in typical(e).items()}


def evaluator(results: tuple[Node, ...]) -> Callable[[dict[str, float]], list[Any]]:
    """A function from inputs by name to the numbers that formulas without networks come to.

    A division by zero, which is selected away, gives NaN.
    """
    nodes = results[0].graph.nodes_for(results)
    at = {node.place: i for i, node in enumerate(nodes)}
    wanted = [at[node.place] for node in results]
    inputs = [(i, node.name) for i, node in enumerate(nodes) if node.operation == "input"]
    constants: list[Any] = [None if node.arguments else node.value for node in nodes]
    steps = [
        (i, _divide if node.operation == "div" else OPERATIONS[node.operation], [at[a.place] for a in node.arguments])
        for i, node in enumerate(nodes)
        if node.arguments
    ]

    def evaluate_at(values: dict[str, float]) -> list[Any]:
        numbers = constants.copy()
        for i, name in inputs:
            numbers[i] = values[name]
        for i, operation, operands in steps:
            numbers[i] = operation(*[numbers[k] for k in operands])
        return [numbers[i] for i in wanted]

    return evaluate_at


def _divide(a: float, b: float) -> float:
    return math.nan if b == 0.0 else OPERATIONS["div"](a, b)


def evaluate(results: tuple[Node, ...], values: dict[str, float]) -> list[Any]:
    """The numbers that formulas without networks come to at these inputs."""
    return evaluator(results)(values)
