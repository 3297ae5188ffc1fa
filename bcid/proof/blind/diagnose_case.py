"""One blind case: its drive is recorded and diagnosed, and the answer compared with what the true effect would gain."""

import time
from collections.abc import Collection, Mapping
from typing import Any

from bcid.diagnosis.diagnose import Diagnosis, diagnose_recordings
from bcid.diagnosis.judge.held_out import held_out_log_likelihoods
from bcid.diagnosis.reference_model import ReferenceModel
from bcid.diagnosis.search.refits import named_effects, refit_with_effects
from bcid.effects.table import EFFECTS
from bcid.estimate.run import estimate_motion
from bcid.estimate.tune import tune_estimator
from bcid.estimate.types import Estimate
from bcid.likelihood.divergence import none_if_diverged
from bcid.likelihood.refit import refit
from bcid.proof.rows import diagnosis_row
from bcid.recording.types import Recording
from bcid.simulation.drive import Drive
from bcid.simulation.samples import VEHICLE
from bcid.vehicle import Vehicle
from bcid.virtual_lab import TUNING, read_simulation_text, read_vehicle_text, record_drive

# as a pipeline file has them where it says nothing else
PERIOD_S, MAX_GAP_S = 0.1, 0.3


def diagnose_concealed_drive(
    drive: Drive, rate_hz: float, left_out: tuple[str, ...], truth: Mapping[str, Mapping[str, float]],
    vehicle_text: str = VEHICLE, simulation_text: str = "", also: Collection[str] = (),
) -> tuple[dict[str, Any], Diagnosis]:  # fmt: skip
    """Record and diagnose a simulated drive with concealed effects; return the JSON row to be scored and the Diagnosis.

    The diagnosis is given only the recording, with poses at `rate_hz`, the vehicle file, a published simulation if
    there is one (TOML, `simulation_text`), and `left_out`, ids of effects that it is forbidden to name.  The estimator
    has what `tune` finds: of the bumper car once for all its takes, of another car from the take.  `truth`, the
    concealed effects' parameters by effect and symbol, is used afterwards for comparison, and so are the ids of effects
    that are there `also`.
    """
    vehicle = read_vehicle_text(vehicle_text)
    recording = record_drive(drive, rate_hz, vehicle, "concealed")
    begin, process = time.perf_counter(), time.process_time()
    estimate, reference = estimate_concealed_drive(recording, vehicle, vehicle_text, simulation_text)
    diagnosis = diagnose_recordings([recording], [estimate], vehicle, reference=reference, excluded=left_out)
    seconds, cpu = time.perf_counter() - begin, time.process_time() - process
    row = {**diagnosis_row(diagnosis), "seconds": round(seconds, 2), "cpu_seconds": round(cpu, 2)}
    return {**row, **_oracle_gain_share(truth, also, diagnosis)}, diagnosis


def estimate_concealed_drive(
    recording: Recording, vehicle: Vehicle, vehicle_text: str, simulation_text: str
) -> tuple[Estimate, ReferenceModel | None]:
    """Estimate the motion of a simulated drive; read the published simulation in `simulation_text`, if there is one.

    `vehicle_text` is the vehicle file (TOML) from which `vehicle` was read.
    """
    tuning = TUNING if vehicle_text == VEHICLE else tune_estimator([recording], vehicle, PERIOD_S, MAX_GAP_S, {})
    estimate = estimate_motion(recording, vehicle, tuning)
    return estimate, read_simulation_text(simulation_text, estimate, vehicle) if simulation_text else None


def _oracle_gain_share(
    truth: Mapping[str, Mapping[str, float]], also: Collection[str], diagnosis: Diagnosis
) -> dict[str, Any]:
    """Held-out log-likelihood gain of a diagnosis over that of an oracle: a refit with the concealed effect itself.

    Returns "oracle_share", the ratio, and "shown", whether the oracle's gain exceeds the effect's gate (nats),
    which chance does not.  `truth` has the concealed effect's parameters, from which the oracle's refit starts.
    Effects that are there `also`, and are named, stand beside it in both, as they may outweigh it.  The ratio is None
    unless exactly one effect is concealed, its refit converges, and it is shown.
    """
    if len(truth) != 1:
        return {"oracle_share": None}
    corrected, fit, take = diagnosis.naming.corrected, diagnosis.fit, diagnosis.take
    ((effect, parameters),) = truth.items()
    corrections = tuple(n for n in fit.hypothesis.effects if n not in EFFECTS)
    beside = (*corrections, *(n for n in named_effects(fit) if n in also and n != effect))
    without = corrected
    if beside != corrections:
        without = none_if_diverged(refit_with_effects, fit, take, beside) or corrected
    hypothesis, old = without.hypothesis.with_effects(*beside, effect), fit.effect_estimates()
    values = [
        parameters[p.symbol] if name == effect else old[field][0]
        for name in hypothesis.effects
        for field, p in zip(hypothesis.entries[name].fields, hypothesis.entries[name].parameters, strict=True)
    ]
    near = fit if hypothesis.effects == fit.hypothesis.effects else without
    start = hypothesis.phi_of(near.car(), values)
    oracle = none_if_diverged(refit, take, hypothesis, start, near.start, near.scales)
    if oracle is None:
        return {"oracle_share": None}
    nothing = held_out_log_likelihoods(without, take).sum()
    best = held_out_log_likelihoods(oracle, take).sum() - nothing
    reached = held_out_log_likelihoods(fit, take).sum() - nothing if fit is not corrected else 0.0
    shown = bool(best > diagnosis.naming.gate_of(effect))
    return {"oracle_share": float(reached / best) if shown else None, "shown": shown}
