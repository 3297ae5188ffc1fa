"""Numbers that decide for which models a process noise is stated, and where a rollout leaves the data."""

from dataclasses import dataclass


@dataclass(frozen=True)
class EvaluationLimits:
    """Limits of the evaluation; none of the values is justified by committed figures yet."""

    # Share of the fastest stretch's mean speed below which no process noise is calibrated on a stretch: the motion of
    # a car at rest cannot be predicted wrongly.
    min_speed_share: float = 0.1
    # Multiple of the largest motion driven plus its range beyond which a prediction error means that the model runs
    # away; it is then given no process noise.
    runaway_factor: float = 10.0
    # Share of the errors that the reported intervals hold, as usual.
    interval_level: float = 0.95
    # Standard deviations that hold 95 % of the errors, from which on a process noise is rejected (normal law: 1.96).
    max_interval_factor: float = 10.0
    # Pushes by which process noise is represented where errors are linearised: one a period, until there are so many,
    # then one every few periods.  The time that a covariance takes grows with them; 200 are 20 s of periods of 0.1 s.
    max_pushes: int = 200
    # Share of a quantity's range in the training takes by which a rollout may leave it unreported.
    range_margin: float = 0.05

    # Share of the shorter take's steps up to which another one may hold them by chance.  Two of the sample logs
    # told in whole centimetres share 0.5 % at most, in millimetres 0.2 %; parts of one take share all that both have.
    max_shared_steps: float = 0.05
    # Steps that two takes of one drive share at least, where they have as many: one or two may be equal by chance.  Of
    # 512 kept ones of a take, 8 are of its 64th part.
    least_shared_steps: int = 8
    # Steps that a model keeps of each take that it was made from: of a tenth of the take, 50 are among them.
    kept_steps: int = 512

    # Share of pairs of fits to one car in which any constant is said to differ, at most: a change in a car costs a
    # day of search, so that one false alarm in a hundred comparisons is what a laboratory bears.
    max_chance: float = 0.01
    # Ratio of a model's residuals to the smoothed motion's standard deviations where the model lacks nothing: of the
    # paper's car by any loss, noise and rate 0.47 to 0.63 (`python tests/measure_residuals.py`).
    usual_residual_ratio: float = 0.53
    # Multiple of the usual ratio above which physics is missing: at most 1.19 where nothing is; of the simulated bumper
    # car with all its extras 1.37 to 2.5 if poses are measured to a millimetre, and 1.19 to 1.24 if to 5 mm.
    max_residual_multiple: float = 1.25


LIMITS = EvaluationLimits()
