"""What is wrong with the base models of real drives, and what two drives of a day miss alike.

`python tests/measure_real_misfits.py RECORDINGS` fits the published simulation of the DART to its drives and writes
docs/results/real_misfits.json, which docs/real_recordings.md tells:

- of a drive of 9 September, how likely it is with the inertia free and with it held where it is published, and how far
  the yaw rate that is predicted without pushes then is from the measured one, by speed;
- of three drives of that day together, where the fit ends, and what an offset of the steering is worth;
- of both drives of 16 September, what two laws that have no name here are worth to first order, each drive by itself:
  a body that leans outward, and steered wheels that fall short of their angle by the same on either side.
"""

from __future__ import annotations

import itertools
import json
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from bcid.aliases import Floats
from bcid.diagnosis.diagnose import fit_base_model
from bcid.diagnosis.search.refits import refit_with_effects
from bcid.effects.remainder_table import INPUTS, WHEEL_ANGLE
from bcid.likelihood.force_history import HISTORY, answer_to, unit_actions
from bcid.likelihood.nuisance import linearise_histories, pose_residuals, without_pushes
from bcid.likelihood.projection import linearise_fit, project_out_fit
from bcid.likelihood.refit import Effort, Fit, refit
from bcid.likelihood.take import Take
from bcid.likelihood.tracking_functions import _rates
from bcid.proof.real.jobs import QuestionInputs, read_questions

ROOT = Path(__file__).parents[1]
ONE, TOGETHER = "15_46_50", ("14_30_56", "16_05_28", "16_15_13")
ALIKE = ("09_16_2024_10_01_01", "09_16_2024_10_02_28")
NORMAL, HELD_SD = 1e6, 0.005
OFFSET_RAD, SPEED_BINS, TURN_RAD = -0.02, 6, 0.05
SHOWN = ("I_z", "K_t", "C_f", "C_r", "F_f_max", "F_r_max")


class Drives:
    """The drives of the DART, by a part of their names."""

    def __init__(self, recordings: Path) -> None:
        questions = read_questions(ROOT / "pipelines" / "dart" / "cases.toml")
        self.inputs = QuestionInputs.of_questions(questions, recordings)

    def fit(self, *parts: str) -> tuple[Fit, Take]:
        """The published simulation fitted to drives together."""
        names = [next(name for name in self.inputs.drives if part in name) for part in parts]
        vehicles = [self.inputs.vehicle_for(name) for name in names]
        read = [self.inputs.estimate_recording(n, v) for n, v in zip(names, vehicles, strict=True)]
        recordings, estimates, _ = zip(*read, strict=True)
        published = self.inputs.published_model(list(estimates), vehicles[0])
        base = fit_base_model(recordings, estimates, vehicles[0], published)
        return base.fit, base.take


def describe(fit: Fit) -> dict[str, Any]:
    """A fit's likelihood, constants, and the scales of its trust by which each parameter is off that is over three."""
    off = zip(fit.hypothesis.parameter_names, fit.hypothesis.prior(fit.phi).deviations(fit.phi), strict=True)
    return {
        "log_likelihood": round(fit.log_likelihood, 1),
        "constants": {symbol: round(getattr(fit.car(), symbol), 4) for symbol in SHOWN},
        "off": {name: round(float(by), 1) for name, by in off if abs(by) > 3.0},
    }


def refit_with_inertia(fit: Fit, take: Take, sd: float) -> Fit:
    """The fit again, by normal laws, from the published inertia, which is known to within `sd` (of its logarithm)."""
    h, at = fit.hypothesis, fit.hypothesis.log_parameters.index("I_z")
    trust = h.trusted_simulation
    assert trust is not None
    known = tuple(sd if k == at else own for k, own in enumerate(trust.sd))
    phi = fit.phi.copy()
    phi[at] = trust.phi[at]
    held = replace(h, trusted_simulation=trust._replace(sd=known, nu=NORMAL))
    return refit(take, held, phi, fit.start, fit.scales, Effort(20))


def yaw_rates_without_pushes(fit: Fit, take: Take) -> list[dict[str, float]]:
    """Mean speed (m/s), measured yaw rate (rad/s), and how far one predicted without pushes is off, by speed."""
    inputs = fit.hypothesis.prediction_inputs(fit.phi, take)
    predicted = take.pose - pose_residuals(take, inputs, without_pushes(fit.start))
    (v, seen), (_, turned) = (_speed_and_yaw_rate(pose, take) for pose in (take.pose, predicted))
    edges = np.quantile(v, np.linspace(0.0, 1.0, SPEED_BINS + 1))
    rows = [(v >= low) & (v <= high) for low, high in itertools.pairwise(edges)]
    means = [[float(np.mean(x[row])) for x in (v, seen, turned - seen)] for row in rows]
    return [dict(zip(("v", "yaw_rate", "off"), np.round(own, 4).tolist(), strict=True)) for own in means]


def _speed_and_yaw_rate(pose: Floats, take: Take) -> tuple[Floats, Floats]:
    """Speed (m/s) and yaw rate (rad/s) at the rows of a take whose poses are `pose` (N, 3)."""
    rate = _rates(pose, take.seen_rows)
    return np.hypot(rate[:, 0], rate[:, 1]), rate[:, 2]


def laws_without_names(fit: Fit, take: Take) -> dict[str, dict[str, float]]:
    """What a lean, and wheels that fall short of their angle, are worth to first order, with their sizes."""
    at = linearise_fit(fit, take)
    inputs = fit.hypothesis.prediction_inputs(fit.phi, take)
    pose = take.pose - at.r
    rate = _rates(pose, take.seen_rows)
    c, s = np.cos(pose[:, 2]), np.sin(pose[:, 2])
    across = (c * rate[:, 0] + s * rate[:, 1]) * rate[:, 2]  # centripetal acceleration
    lean = np.column_stack([-s * across, c * across, np.zeros_like(across)])
    history = linearise_histories(take, inputs, fit.start).history
    turn = np.tanh(history.along[:, :, INPUTS.index("delta")] / TURN_RAD)
    acted = unit_actions(history.along, inputs.car)[..., WHEEL_ANGLE] * turn[:, :, None]
    play = answer_to(history.D, acted.reshape(len(turn), HISTORY, 1), take.first)
    known = project_out_fit(at, np.concatenate([lean[:, :, None], play], axis=2), widest=2)
    both = slice(0, 2)
    slope, information = known.slope(both), known.information(both)
    size, error = np.linalg.solve(information, slope), np.sqrt(np.diag(np.linalg.inv(information)))
    alone = 0.5 * slope**2 / np.diag(information)
    return {
        name: {"size": float(f"{size[k]:.3g}"), "se": float(f"{error[k]:.2g}"), "nats_alone": round(float(alone[k]), 1)}
        for k, name in enumerate(("lean_m_per_mps2", "play_rad"))
    }


def measure(recordings: Path) -> dict[str, Any]:
    """All figures."""
    drives = Drives(recordings)
    fit, take = drives.fit(ONE)
    sd = fit.hypothesis.trusted_simulation.sd[fit.hypothesis.log_parameters.index("I_z")]  # type: ignore[union-attr]
    free, held = (refit_with_inertia(fit, take, within) for within in (sd, HELD_SD))
    joint, takes = drives.fit(*TOGETHER)
    offset = refit_with_effects(joint, takes, ("steering_offset",), [OFFSET_RAD])
    o, se = offset.effect_estimates()["steering_offset__o"]
    return {
        "inertia": {"drive": ONE, "free": describe(free), "held": describe(held),
                    "yaw_rate_of_held": yaw_rates_without_pushes(held, take)},
        "together": {
            "drives": list(TOGETHER), "without_offset": describe(joint), "with_an_offset": describe(offset),
            "offset": {"nats": round(offset.penalised_log_likelihood - joint.penalised_log_likelihood, 1),
                       "rad": round(o, 5), "se": round(se, 5)},
        },
        "alike": {part: laws_without_names(*drives.fit(part)) for part in ALIKE},
    }  # fmt: skip


def main() -> None:
    """Measure and write."""
    path = ROOT / "docs" / "results" / "real_misfits.json"
    path.write_text(json.dumps(measure(Path(sys.argv[1])), indent=1) + "\n", encoding="utf-8")
    print(path.read_text(encoding="utf-8"))  # noqa: T201


if __name__ == "__main__":
    main()
