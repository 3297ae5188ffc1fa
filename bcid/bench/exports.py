"""Times of a step of exported models, as C, beside the C that casadi generates of the same formulas."""

import ctypes
import importlib.util
import tempfile
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from bcid.aliases import Floats
from bcid.bench.c_code import load_c, pointer
from bcid.bench.car_in_c import generate_c
from bcid.bench.limits import SPEED
from bcid.bench.rollouts import draw_commands
from bcid.bench.timing import PeerMissing, Skipped, TimedPeer, Timing, Work, require, time_against_peers
from bcid.effects.constants import Constants
from bcid.export.c_source import write_c_header, write_c_source
from bcid.export.casadi_source import write_casadi_source
from bcid.export.exported import Exported, export_model
from bcid.models import published
from bcid.models.interface import Model
from bcid.models.kinematic import library
from bcid.models.kinematic.k_sindy import KSindy
from bcid.models.kinematic.k_sindy_mlp import KSindyMlp
from bcid.models.kinematic.sparse_sum import SparseEquations
from bcid.models.kinematic.state import KinematicCar
from bcid.models.limits import LIMITS as MODEL_LIMITS
from bcid.models.network.mlp import MlpWeights
from bcid.models.newton_euler.augmented import AugmentedNewtonEuler
from bcid.models.newton_euler.model import NewtonEuler

STEPS, PERIOD_S = 1000, 0.1
HIDDEN = (128, 64)  # of the residual network of the sample's k-sindy-mlp
SAMPLE_EFFECTS = {
    "two_rear_wheels__t": 0.6, "rough_patch__b": 30.0, "rough_patch__x": 1.8, "rough_patch__y": -0.9,
    "rough_patch__radius": 1.2, "tyre_soft_saturation__s": 0.6, "rear_rolling_viscous__b": 11.0,
}  # fmt: skip
"""What the diagnosis of the sample logs finds."""

OUR_LOOP = """
void begin(double *x)
{{
    const double pose[3] = {{0.0, 0.0, 0.0}}, twist[3] = {{1.0, 0.0, 0.0}};
    {name}_init(pose, twist, 0.0, x);
}}

void loop(const double *start, const double *u, double *out, long n)
{{
    double x[{states}];
    for (int i = 0; i < {states}; ++i) x[i] = start[i];
    for (long k = 0; k < n; ++k) {name}_step(x, u + 2 * k, x, out + 3 * k);
}}
"""
CASADI_LOOP = """
void loop(const double *start, const double *u, double *out, long n)
{{
    double x[{states}], w[{work} + 1];
    casadi_int iw[{whole} + 1];
    for (int i = 0; i < {states}; ++i) x[i] = start[i];
    for (long k = 0; k < n; ++k) {{
        double next[{states}];
        const double *arg[{arguments}] = {{x, u + 2 * k}};
        double *res[{results}] = {{next, out + 3 * k}};
        {name}_step(arg, res, iw, w, 0);
        for (int i = 0; i < {states}; ++i) x[i] = next[i];
    }}
}}
"""


def time_exported_steps(repeats: int) -> Iterator[Timing | Skipped]:
    """Yield timings of 1000 steps of exported models, as C, beside casadi's C of the same formulas.

    Times are medians of `repeats` turns; differences are the largest between the twists (m/s, rad/s).
    """
    commands = draw_commands(STEPS)
    for model, longest_us, goal, tolerated in _models():
        e = export_model(model, "0" * 64, None)
        path = f"exported {model.name} in C, {STEPS} steps"
        try:
            mine = load_c(_our_source(e))
        except PeerMissing as missing:
            yield Skipped(path, "C by casadi", str(missing))
            continue
        start = np.zeros(len(e.formulas.states))
        mine.begin(pointer(start))
        peer = TimedPeer(partial(_loop_by_casadi, e, start, commands), goal, tolerated)
        ours, longest_ms = partial(_drive, mine, start, commands), 1e-3 * STEPS * longest_us
        yield from time_against_peers(path, ours, {"C by casadi": peer}, repeats, longest_ms)


def _models() -> Iterator[tuple[Model, float, float, float]]:
    """Each model with the longest time of a step (us), the lowest ratio to casadi's, and the largest difference."""
    car = published.newton_euler().car
    yield NewtonEuler(car, PERIOD_S, {}), SPEED.exported_us, SPEED.exported_ratio, SPEED.max_difference
    yield _k_sindy_mlp(), SPEED.exported_network_us, SPEED.exported_network_ratio, MODEL_LIMITS.single_precision_error
    augmented = AugmentedNewtonEuler(car, SAMPLE_EFFECTS, Constants(), 2.0, 300.0, PERIOD_S, {})
    yield augmented, SPEED.exported_augmented_us, SPEED.exported_ratio, SPEED.max_difference


def _k_sindy_mlp() -> KSindyMlp:
    """A sparse sum of twenty terms, and a perceptron of the sample's size, at random."""
    rng, frame = np.random.default_rng(0), KinematicCar(0.54, 0.33, 0.155, 1.418, PERIOD_S)
    xi_v, xi_f, xi_r = (np.zeros(n) for n in (len(library.SPEED_TERMS), *2 * [len(library.SLIP_TERMS)]))
    xi_v[:8], xi_f[:6], xi_r[:6] = 1e-3, 1e-3, 1e-3
    xi_v[4], xi_f[0], xi_r[1] = 0.98, 0.9, 0.9
    sizes = [(6, HIDDEN[0]), HIDDEN, (HIDDEN[1], 3)]
    W = [rng.normal(0.0, n**-0.5, (n, m)).astype(np.float32) for n, m in sizes]
    b = [np.zeros(m, dtype=np.float32) for _, m in sizes]
    ones = np.ones(6)
    weights = MlpWeights(0.0 * ones, ones, W[0], b[0], W[1], b[1], W[2], b[2], np.zeros(3), np.full(3, 1e-2))
    sparse = SparseEquations(xi_v, xi_f, xi_r, library.SPEED_TERMS, library.SLIP_TERMS)
    return KSindyMlp(KSindy(sparse, frame, {}), weights, {})


def _our_source(e: Exported) -> str:
    """The exported C in one text, with a loop over its steps, and a function that gives the first state."""
    header = write_c_header(e)
    body = write_c_source(e).replace(f'#include "{e.name}.h"', header)
    return body + OUR_LOOP.format(name=e.name, states=len(e.formulas.states))


def _drive(library_: ctypes.CDLL, start: Floats, commands: Floats) -> Floats:
    """The twists (N, 3) after each of `commands` (N, 2), by the function `loop` of a compiled library."""
    out = np.empty((len(commands), 3))
    library_.loop(pointer(start), pointer(commands), pointer(out), ctypes.c_long(len(commands)))
    return out


def _loop_by_casadi(e: Exported, start: Floats, commands: Floats) -> Work:
    """Compile the C that casadi generates of the exported formulas, with a loop around it; return the call."""
    require("casadi")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"{e.name}_casadi.py"
        path.write_text(write_casadi_source(e), encoding="utf-8")
        step = _load_module(path).step_function()
        generated = generate_c(step, Path(folder))
    loop = CASADI_LOOP.format(
        name=e.name, states=len(e.formulas.states), work=step.sz_w(), whole=step.sz_iw(),
        arguments=step.sz_arg(), results=step.sz_res(),
    )  # fmt: skip
    return partial(_drive, load_c(generated + loop), start, commands)


def _load_module(path: Path) -> Any:
    """The module in the file at `path`."""
    spec = importlib.util.spec_from_file_location(path.stem, path)
    if spec is None or spec.loader is None:
        raise PeerMissing(f"{path.name} cannot be imported")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module
