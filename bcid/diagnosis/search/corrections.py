"""What is put right beside names: the base model's own simplifications, and two delays that are one of the pose.

The base model's simplifications (`bcid.effects.corrections`) are fitted first, so that they are not mistaken for an
effect.
"""

from bcid.diagnosis.limits import SEARCH_LIMITS
from bcid.diagnosis.search import refits
from bcid.diagnosis.search.refits import gain_nats, named_effects, refit_with_effects
from bcid.effects.corrections import CORRECTIONS
from bcid.effects.table import ENTRIES
from bcid.likelihood.divergence import none_if_diverged
from bcid.likelihood.limits import LIKELIHOOD_LIMITS
from bcid.likelihood.refit import Fit, refit
from bcid.likelihood.take import Take

COMMAND_DELAYS = ("steering_delay", "motor_delay")

# share of their declared sizes from which the corrections are refitted
FIRST_SHARE = 0.1


def fit_corrections(base: Fit, take: Take) -> Fit:
    """The base model refitted with those of its own simplifications (CORRECTIONS) corrected that are certainly wrong.

    Kept are corrections with an amplitude many standard errors from zero (`is_certain`), if together they gain
    `LIKELIHOOD_LIMITS.usual_gate_nats` of penalised log-likelihood; otherwise `base` is returned.
    """
    free = [n for n in CORRECTIONS if n in base.hypothesis.entries and n not in base.hypothesis.assumed]
    sizes = [p.size for n in free for p in base.hypothesis.entries[n].parameters]
    all_free = base.hypothesis.with_effects(*free)
    known = base.hypothesis.effect_values(base.phi).values()
    start = all_free.phi_of(base.car(), [*known, *(FIRST_SHARE * size for size in sizes)])
    quick = none_if_diverged(refit, take, all_free, start, base.start, base.scales, refits.QUICK, base.tangent)
    if quick is None or gain_nats(quick, base) < LIKELIHOOD_LIMITS.usual_gate_nats:
        return base
    full = refits.refit_fully(quick, take)
    kept = tuple(n for n in free if is_certain(full, n))
    if not kept:
        return base
    corrected = full if len(kept) == len(free) else refit_with_effects(full, take, kept)
    # a refit may end at another, lower maximum
    return corrected if gain_nats(corrected, base) > LIKELIHOOD_LIMITS.usual_gate_nats else base


def is_certain(fit: Fit, name: str) -> bool:
    """Whether an amplitude of effect `name` is more than `SEARCH_LIMITS.certain_se` standard errors from zero.

    For such an effect (by this Wald test) no refit without it is made to see what it gains.
    """
    estimates = refits.estimates_by_symbol(fit, name)
    amplitudes = (estimates[p.symbol] for p in ENTRIES[name].amplitude_parameters)
    return any(abs(value) > SEARCH_LIMITS.certain_se * se > 0.0 for value, se in amplitudes)


def replace_delays_by_latency(fit: Fit, take: Take) -> Fit:
    """The fit with a pose latency in place of the delays of both commands, if that raises the penalised log-likelihood.

    The latency starts at the mean of the two delays.  A fit without both delays, or with a latency, is returned as is.
    """
    held = fit.hypothesis.effects
    if not set(COMMAND_DELAYS) <= set(named_effects(fit)) or "pose_latency" in held:
        return fit
    tau = 0.5 * sum(fit.effect_estimates()[f"{name}__tau"][0] for name in COMMAND_DELAYS)
    late = refit_with_effects(fit, take, (*(n for n in held if n not in COMMAND_DELAYS), "pose_latency"), [tau])
    return late if late.penalised_log_likelihood > fit.penalised_log_likelihood else fit
