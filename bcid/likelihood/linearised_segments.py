"""The likelihood of many hypotheses, quickly: initial states and pushes of all segments answer linearly."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from bcid.aliases import Floats
from bcid.likelihood import nuisance
from bcid.likelihood.hypothesis import Hypothesis
from bcid.likelihood.prior import Prior
from bcid.likelihood.refit import Fit
from bcid.likelihood.refit_state import MAX_EM_STEPS, RefitProblem, build_state
from bcid.likelihood.scales import Scales
from bcid.likelihood.take import Take


class LinearisedSegments(NamedTuple):
    """Initial states and pushes of all segments, and how predicted poses answer them."""

    start: Floats  # (S, N_NUISANCE)
    A: Floats  # (N, 3, N_NUISANCE) derivatives of predicted poses
    scales: Scales  # from which those of noise and pushes are sought


def linearise_with_pushes(fit: Fit) -> LinearisedSegments:
    """Initial states and pushes as a fit has them; its pushes may make up for what it lacks."""
    return LinearisedSegments(fit.start, fit.tangent.A, fit.scales)


def linearise_without_pushes(fit: Fit, take: Take) -> LinearisedSegments:
    """The initial states of a fit to a take, without its pushes: poses are off by what the fit lacks."""
    start, inputs = nuisance.without_pushes(fit.start), fit.hypothesis.prediction_inputs(fit.phi, take)
    return LinearisedSegments(start, nuisance.linearise_nuisances(take, inputs, start).A, fit.scales)


def log_likelihood_along(at: LinearisedSegments, take: Take, hypothesis: Hypothesis, phi: Floats) -> float:
    """The log-likelihood (nats) of a hypothesis at phi, poses being linear in initial states and pushes about `at`.

    The scales of noise and pushes are found anew.
    """
    problem = RefitProblem(take, hypothesis, Prior.normal(phi, np.zeros_like(phi)))
    r = problem.residuals(phi, at.start)
    return build_state(problem, phi, at.start, at.scales, r, at.A, MAX_EM_STEPS).objective
