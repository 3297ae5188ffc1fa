"""How far models of a real drive hold on a faster one of the same day, and how sure the evidence of a remainder is.

`python tests/measure_extrapolation.py RECORDINGS` fits the DART to the slow drive of 16 September, freely, beside the
published simulation, and beside it with tyres and inertia held, and predicts both drives of that day 2 s ahead, by the
fit and by the car of the fit with a remainder beside it.  It finds remainders beside two fits that begin with another
grip of the rear tyres, too.  It writes docs/results/real_extrapolation.json, which docs/real_recordings.md tells.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np

from bcid.diagnosis.diagnose import fit_base_model
from bcid.diagnosis.judge.fitted_models import model_from_reference
from bcid.diagnosis.reference_model import ReferenceModel
from bcid.diagnosis.remainder.explain import basis_for, explain
from bcid.diagnosis.remainder.fit import RemainderFit, fit_with_remainder
from bcid.evaluation.closed_loop import position_errors
from bcid.likelihood.refit import Effort, Fit, refit
from bcid.likelihood.take import Take
from bcid.proof.real.jobs import QuestionInputs, read_questions

ROOT = Path(__file__).parents[1]
SLOW, FAST = "09_16_2024_10_01_01", "09_16_2024_10_02_28"
HORIZON_S = 2.0
FIRM, FIRM_SD = ("C_f", "C_r", "F_f_max", "F_r_max", "I_z"), 0.03
SHOWN = ("I_z", "C_f", "C_r", "F_f_max", "F_r_max", "R_1", "R_2", "K_t")


def measure(recordings: Path) -> dict[str, Any]:
    """All figures, by drive and by model."""
    questions = read_questions(ROOT / "pipelines" / "dart" / "cases.toml")
    inputs = QuestionInputs.of_questions(questions, recordings)
    names = {short: next(name for name in inputs.drives if short in name) for short in (SLOW, FAST)}
    vehicles = {short: inputs.vehicle_for(name) for short, name in names.items()}
    read = {short: inputs.estimate_recording(names[short], vehicles[short]) for short in names}
    recording, estimate, _ = read[SLOW]
    published = inputs.published_model([estimate], vehicles[SLOW])
    assert published is not None
    free = fit_base_model([recording], [estimate], vehicles[SLOW], None)
    known = fit_base_model([recording], [estimate], vehicles[SLOW], published)
    firmly = published._replace(relative_sd_of={**published.relative_sd_of, **dict.fromkeys(FIRM, FIRM_SD)})
    firm = fit_base_model([recording], [estimate], vehicles[SLOW], firmly)
    fits = {"fitted freely": free, "fitted beside the published": known, "tyres and inertia held": firm}
    models = {name: ReferenceModel.from_fit(base.fit) for name, base in fits.items()}
    besides = {f"{n}, beside a remainder": with_remainder(b.fit, b.take).fit for n, b in fits.items() if b is not free}
    models |= {name: ReferenceModel.from_fit(fit) for name, fit in besides.items()} | {"published": published}

    def error(model: ReferenceModel, short: str) -> dict[str, float | None]:
        rows = read[short][1]
        length_s = float(np.ptp(rows.time_s))
        errors = position_errors(model_from_reference(model, vehicles[short], length_s, rows.period_s), rows, HORIZON_S)
        median = float(np.median(errors))
        return {
            "median_m": round(median, 3) if np.isfinite(median) else None,
            "lost": round(float(np.mean(~np.isfinite(errors))), 3),
        }

    return {
        "fitted_to": SLOW,
        "drives": {short: speeds_driven(read[short][1]) for short in names},
        "models": {
            name: {
                "constants": {symbol: round(getattr(model.car, symbol), 4) for symbol in SHOWN},
                **{f"on {short}": error(model, short) for short in names},
            }
            for name, model in models.items()
        },
        "log_likelihood": {name: round(base.fit.log_likelihood, 1) for name, base in fits.items()},
        "remainders": [
            remainder_beside(known.fit, known.take),
            remainder_beside(with_rear_grip(known.fit, known.take, published), known.take),
        ],
    }


def speeds_driven(estimate: Any) -> dict[str, list[float]]:
    """Median, 90 and 99 % quantiles of speed ahead (m/s) and of the acceleration across (m/s^2)."""
    v_x, yaw_rate = np.abs(estimate.twist[:, 0]), np.abs(estimate.twist[:, 2])
    return {
        key: [round(float(x), 2) for x in np.quantile(values, [0.5, 0.9, 0.99])]
        for key, values in (("speed_mps", v_x), ("across_mps2", v_x * yaw_rate))
    }


def with_rear_grip(fit: Fit, take: Take, published: ReferenceModel) -> Fit:
    """The fit again, from where the rear tyres have the published grip."""
    phi = fit.phi.copy()
    phi[fit.hypothesis.log_parameters.index("F_r_max")] = np.log(published.car.F_r_max)
    return refit(take, fit.hypothesis, phi, fit.start, fit.scales, Effort(20))


def with_remainder(fit: Fit, take: Take) -> RemainderFit:
    """The fit with what has no name beside it."""
    return fit_with_remainder(fit, take, explain(fit, take, basis_for(fit, take)))


def remainder_beside(fit: Fit, take: Take) -> dict[str, float]:
    """What a fit reaches alone, and the evidence with a remainder beside it (nats)."""
    rest = with_remainder(fit, take)
    return {
        "F_r_max": round(fit.car().F_r_max, 3), "alone": round(fit.penalised_log_likelihood, 1),
        "with_remainder": round(rest.log_evidence, 1), "remainder": round(rest.nats, 1),
    }  # fmt: skip


if __name__ == "__main__":
    text = json.dumps(measure(Path(sys.argv[1])), indent=1)
    (ROOT / "docs" / "results" / "real_extrapolation.json").write_text(text + "\n", encoding="utf-8")
    print(text)  # noqa: T201
