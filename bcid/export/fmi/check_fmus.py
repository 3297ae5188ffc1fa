"""FMUs are validated and simulated by FMPy, as their users will, and compared with the model itself."""

from __future__ import annotations

import contextlib
import io
from pathlib import Path
from typing import Any

import numpy as np

from bcid.aliases import Floats
from bcid.errors import InputRefused
from bcid.evaluation.closed_loop import integrate_poses
from bcid.export.check import NO_COMPILER, NOT_THE_MODEL, OWN_FAULT, Checked, find_compiler
from bcid.export.exported import Exported
from bcid.export.formulas import COMMANDS, POSE, START, TWIST
from bcid.export.reference_drive import EXACT
from bcid.libraries import is_installed

CLOSED_LOOP = 20.0
"""How many times the tolerance of a step a network may be off in closed loop.

An FMU keeps its state to itself, so that a network cannot be compared from the model's own state in every step, as the
other formats are: what single precision rounds in 200 steps adds up.
"""


def check_fmus(folder: Path, e: Exported) -> Checked:
    """Validate NAME.fmu and NAME_fmi2.fmu in `folder`, and drive them by the 200 commands of `e`, one a step.

    Their poses must be those of their own twists.  Single periods are not tried, since an FMU starts from no state; the
    C in it is that which `check_c` tries.  A network may be off by 20 times its tolerance of 1e-6 (`CLOSED_LOOP`): it
    runs in closed loop here, not each step from the model's own state.

    Returns the largest error of the twist (m/s, rad/s) of both, or why they could not be checked.

    Raises:
        InputRefused: one is not valid, cannot be simulated, or is not as exact as it must be.
    """
    if not is_installed("fmpy"):
        return Checked(None, "fmpy is not installed")
    if find_compiler() is None:
        return Checked(None, NO_COMPILER)
    return Checked(max(_check(folder / f"{e.name}{end}.fmu", e) for end in ("", "_fmi2")))


def _check(fmu: Path, e: Exported) -> float:
    """The largest error of the twist of one FMU."""
    tolerance = e.vectors.tolerance * (1.0 if e.vectors.states is None else CLOSED_LOOP)
    driven: Floats | None = None
    # FMPy prints what the FMU logs.  A logger of our own it would keep after it is gone, and call for other FMUs.
    with contextlib.redirect_stdout(io.StringIO()) as said:
        try:
            from fmpy.validation import validate_fmu

            problems = "; ".join(validate_fmu(str(fmu)))
            driven = None if problems else drive_fmu(fmu, e)
        except Exception as failure:  # FMPy raises plain ones
            problems = str(failure)
    if driven is None:
        raise _refuse(fmu, f"cannot be simulated: {problems} {said.getvalue().strip()[-800:]}")
    poses, twists = np.split(driven, 2, axis=1)
    error = float(np.max(np.abs(twists - e.vectors.twists)))
    if not error <= tolerance:
        raise _refuse(fmu, f"{NOT_THE_MODEL}: it is off by {error:.3g} m/s, rad/s")
    of_twists = integrate_poses(e.vectors.pose, np.vstack([e.vectors.twist, twists]), e.formulas.period_s)[1:]
    off = float(np.max(np.abs(poses - of_twists)))
    if not off <= EXACT:
        raise _refuse(fmu, f"{NOT_THE_MODEL}: its poses are off those of its twists by {off:.3g} m, rad")
    return error


def drive_fmu(fmu: Path, e: Exported, start_s: float = 0.0) -> Floats:
    """Poses and twists (200, 6) of an FMU from `start_s` (s) on, after each period, by FMPy, which must be installed.

    It starts as the drive by which `e` is checked does, and gets that drive's commands.

    Raises:
        Exception: FMPy cannot simulate it; it prints what the FMU logged.
    """
    from fmpy import simulate_fmu

    v, period_s = e.vectors, e.formulas.period_s
    times = start_s + period_s * np.arange(len(v.commands) + 1)
    commands = np.column_stack([times[:-1], v.commands])
    names = [q.name for q in (*POSE, *TWIST)]
    columns = [(name, float) for name in ("time", *(q.name for q in COMMANDS))]
    result: Any = simulate_fmu(
        str(fmu), start_time=times[0], stop_time=times[-1], output_interval=period_s,
        start_values=dict(zip((q.name for q in START), [*v.pose, *v.twist, v.delta], strict=True)),
        input=np.array([tuple(row) for row in commands], columns), output=names,
    )  # fmt: skip
    return np.column_stack([result[name] for name in names])[1:]


def _refuse(fmu: Path, cause: str) -> InputRefused:
    """The error that an FMU is not as it must be."""
    return InputRefused(fmu, "export to FMI", cause.strip(), OWN_FAULT)
