"""Which drive of the catalogue separates two rival explanations best."""

from contextlib import suppress
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from bcid.aliases import Floats
from bcid.effects.table import ENTRIES
from bcid.errors import PredictionDiverged
from bcid.experiment.limits import EXPERIMENT_LIMITS
from bcid.experiment.manoeuvres import ARENA, Arena, PlannedDrive, feasible_drives, stays_inside
from bcid.experiment.simulate import NO_NOISE, commands_only_take, simulate_states, simulate_take
from bcid.likelihood.hypothesis import Hypothesis
from bcid.likelihood.jacobian import parameter_jacobian
from bcid.likelihood.limits import LIKELIHOOD_LIMITS
from bcid.likelihood.marginal import checked_marginal_terms, score_and_information, segment_moments
from bcid.likelihood.newton import evaluate_at
from bcid.likelihood.nuisance import about_no_pushes, linearise_nuisances, pose_residuals
from bcid.likelihood.prediction_inputs import PredictionInputs
from bcid.likelihood.refit import Fit
from bcid.likelihood.refit_state import RefitProblem
from bcid.likelihood.scales import Scales
from bcid.likelihood.take import Take
from bcid.physics.car import integration_step

POSE_HZ = 20.0  # of the simulated takes: one pose per group


@dataclass(frozen=True)
class DiscriminatingDrive(PlannedDrive):
    """The drive that separates two rival explanations best, with the reason."""

    why: str
    score: float  # nats: expected log-likelihood difference of one drive
    repeats: int  # drives until the difference reaches `usual_gate_nats`


def _prediction_inputs(drive: PlannedDrive, hypothesis: Hypothesis, phi: Floats) -> PredictionInputs:
    """Inputs of a prediction of a drive by the model `hypothesis`: car, effect parameters, actuator outputs.

    Its parameters `phi` are the logarithms of the base parameters, then the effects' parameters.
    """
    take = commands_only_take(drive.command_s, drive.command, drive.seconds, integration_step(hypothesis.nominal))
    return hypothesis.prediction_inputs(phi, take)


def simulate_planned_drive(
    drive: PlannedDrive, hypothesis: Hypothesis, phi: Floats, scales: Scales = NO_NOISE, seed: int = 0
) -> tuple[Take, PredictionInputs]:
    """Simulate a drive with the model `hypothesis`; return its poses as a take, and the inputs of the prediction.

    The model's parameters `phi` are the logarithms of the base parameters, then the effects' parameters.  Measurement
    noise and random disturbances have the standard deviations `scales`, by default zero.
    """
    inputs = _prediction_inputs(drive, hypothesis, phi)
    return simulate_take(
        inputs, drive.command_s, drive.command, drive.seconds, scales, POSE_HZ, seed, drive.initial_state
    ), inputs  # fmt: skip


def segment_information(take: Take, inputs: PredictionInputs, scales: Scales, columns: Floats) -> Floats:
    """Fisher information C^T P C (S, n, n), for each segment, about n coefficients with derivatives C of the poses.

    C is the segment's part of `columns` (N, 3, n).  P is the precision of the measurement noise (standard deviations
    `scales.r`) with each segment's initial state and disturbances, Gaussian with `scales.q`, marginalised.

    Raises:
        PredictionDiverged: where rounding errors make the marginalisation meaningless.
    """
    A, still = linearise_nuisances(take, inputs, take.start).A, np.zeros_like(take.pose)
    root = checked_marginal_terms(segment_moments(still, A, take.first), scales).root
    return np.asarray(score_and_information(still, A, columns, take.first, scales.r, root)[1])


class Separation(NamedTuple):
    """What one drive shows of the difference d of two explanations, beside refitted parameters with Jacobian J."""

    square: float  # d^T P d
    slope: Floats  # (n,) J^T P d
    curvature: Floats  # (n, n) J^T P J
    known: Floats  # (n, n) information of the parameters before the drive

    def score(self, repeats: int = 1) -> float:
        """Expected log-likelihood difference (nats) after `repeats` drives, the true explanation being refitted."""
        total = repeats * self.curvature + self.known
        taken = np.linalg.lstsq(total, repeats * self.slope, rcond=None)[0]
        return 0.5 * repeats * float(self.square - self.slope @ taken)


def measure_separation(drive: PlannedDrive, truth: Fit, rival: Fit) -> Separation:
    """Compute, for one drive, the terms of the expected log-likelihood difference of two fitted models.

    They are d^T P d, J^T P d and J^T P J: d is what is left between both predictions, J the Jacobian of `truth` and P
    the noise's precision with initial states and disturbances marginalised.  The drive is simulated with `truth`.
    `rival` predicts each segment from the initial state, and under the disturbances, with which it comes nearest to
    that: from the simulated one a car that rolls to rest may end far away, which is no sign of either.
    """
    known = np.asarray(np.linalg.pinv(truth.covariance), dtype=float)
    take, inputs = simulate_planned_drive(drive, truth.hypothesis, truth.phi)
    r = pose_residuals(take, inputs, take.start)
    of_rival = RefitProblem(take, rival.hypothesis, rival.hypothesis.prior(rival.phi))
    nearest = evaluate_at(of_rival, rival.phi, take.start, truth.scales, em_steps=0)
    d = -about_no_pushes(nearest.r, nearest.A, nearest.start, take.first)
    J = parameter_jacobian(take, truth.hypothesis, truth.phi, take.start, r, range(len(known)))
    G = segment_information(take, inputs, truth.scales, np.concatenate([J, d[:, :, None]], axis=2)).sum(axis=0)
    return Separation(float(G[-1, -1]), G[:-1, -1], G[:-1, :-1], known)


def find_discriminating_drive(
    truth: Fit, rival: Fit, max_throttle: float, arena: Arena = ARENA
) -> DiscriminatingDrive | None:
    """Find the catalogue's drive that discriminates best between two rival fits, in at most `max_repeats` repeats.

    "Best" is by the expected log-likelihood difference if `truth` is true: half of d^T P d, summed over segments, d
    being what is left between both predictions (`measure_separation`) and P the noise's precision with initial
    states and disturbances marginalised; the part of d that refitted parameters of `truth` could explain is
    projected out.  None if the difference after all repeats is below `usual_gate_nats`.  `max_throttle` is a speed
    (m/s), or 1 where the throttle sets a force.
    """
    hypothesis, phi = truth.hypothesis, truth.phi
    walls, found = arena._replace(margin=0.0), list[tuple[PlannedDrive, Separation]]()
    for drive in feasible_drives(hypothesis.car(phi), hypothesis.angle_limit, max_throttle, arena):
        # a car that follows a take of seconds may not last a whole drive
        with suppress(PredictionDiverged, np.linalg.LinAlgError):
            # the catalogue does not know the effects of the truth
            if stays_inside(simulate_planned_drive(drive, hypothesis, phi)[0].pose, walls):
                found.append((drive, measure_separation(drive, truth, rival)))
    if not found:
        return None
    drive, best = max(found, key=lambda pair: pair[1].score())
    numbers = range(1, EXPERIMENT_LIMITS.max_repeats + 1)
    repeats = next((n for n in numbers if best.score(n) >= LIKELIHOOD_LIMITS.usual_gate_nats), None)
    if repeats is None:
        return None
    why = _explain_choice(hypothesis, rival.hypothesis, drive, phi)
    return DiscriminatingDrive(**vars(drive), why=why, score=best.score(), repeats=repeats)


def _explain_choice(truth: Hypothesis, rival: Hypothesis, drive: PlannedDrive, phi: Floats) -> str:
    """One sentence on why a drive discriminates between two hypotheses, for the user.

    It says what the effects in only one of them depend on, and the drive's range in that, such as "yaw scrub depends on
    yaw rate. The drive has yaw rate from -1.20 to 1.20 rad/s."  The drive is simulated with `truth` at its parameters
    `phi`.
    """
    ranges = _describe_ranges(drive, truth, phi)
    names = [n for n in (*truth.effects, *rival.effects) if (n in truth.effects) != (n in rival.effects)]
    reasons = [f"{_words(n)} depends on {' and '.join(map(_words, ENTRIES[n].depends_on))}" for n in names]
    quantities = list(dict.fromkeys(q for n in names for q in ENTRIES[n].depends_on)) or ["v_x", "steering"]
    spans = [ranges[q] for q in quantities]
    return f"{'; '.join(reasons) or 'They differ in the base parameters'}. The drive has {', '.join(spans)}."


def _words(name: str) -> str:
    """An effect or a quantity in words."""
    return name if name in ("v_x", "v_y") else name.replace("_", " ")


def _describe_ranges(drive: PlannedDrive, hypothesis: Hypothesis, phi: Floats) -> dict[str, str]:
    """Ranges of speed, steering, slip and so on in a drive, as texts such as "speed from 0.10 to 2.00 m/s".

    They are by quantity, from the 1 % to the 99 % quantile, of the drive simulated by the `hypothesis` at its
    parameters `phi` (logarithms of the base parameters, then the effects').
    """
    inputs = _prediction_inputs(drive, hypothesis, phi)
    path = simulate_states(inputs, drive.seconds, NO_NOISE, 0, drive.initial_state)
    p, delta, u = inputs.car, inputs.chain.delta[::2], drive.command[:, 1]
    v_x, v_y, omega = path[:, 3:].T
    hub, rear = v_y + p.l_f * omega, v_y - p.l_r * omega
    along, across = np.cos(delta) * v_x + np.sin(delta) * hub, np.cos(delta) * hub - np.sin(delta) * v_x
    wide = np.ptp(path[:, :2], axis=0)

    def span(word: str, values: Floats, unit: str) -> str:
        """Text "word from low to high unit" of the central 98 % of the values."""
        low, high = np.quantile(values, [0.01, 0.99])
        return f"{word} from {low:.2f} to {high:.2f} {unit}".rstrip()

    alpha_f = np.arctan(across / np.maximum(np.abs(along), p.v_0))
    alpha_r = np.arctan(rear / np.maximum(np.abs(v_x), p.v_0))
    return {
        "v_x": span("v_x", v_x, "m/s"), "v_y": span("v_y", v_y, "m/s"),
        "speed": span("speed", np.hypot(v_x, v_y), "m/s"), "yaw_rate": span("yaw rate", omega, "rad/s"),
        "steering": span("steering", delta, "rad"), "heading": span("heading", path[:, 2], "rad"),
        "steering_rate": span("steering rate", np.gradient(delta, inputs.chain.h), "rad/s"),
        "throttle": span("throttle", np.maximum(u, 0.0), ""), "braking": span("braking", np.maximum(-u, 0.0), ""),
        "alpha_f": span("front slip", alpha_f, "rad"), "alpha_r": span("rear slip", alpha_r, "rad"),
        "place": f"{wide[0]:.1f} by {wide[1]:.1f} m of floor", "time": f"{drive.seconds:.0f} s",
    }  # fmt: skip
