"""What a take says of any history of forces: products of a fit's residual and derivatives in each segment.

Of a segment let r be the residual, A its derivatives by initial state and pushes, with posterior covariance V, all over
the noise, and P = 1 - A V A^T.  Names act by derivatives J, what has no name by carriers Q: accelerations of the body
and turns of the wheel in each knot (`bcid.likelihood.force_history`), and functions in the tracking.  The products
J^T P J, J^T P Q, Q^T P Q, J^T P r and Q^T P r are all that the likelihood needs to first order, for any functions.
"""

from __future__ import annotations

import itertools
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from bcid.aliases import Floats, Ints
from bcid.diagnosis.remainder.evidence import Quadratic
from bcid.diagnosis.remainder.functions import RemainderBasis
from bcid.likelihood.force_history import ACTIONS, history_values
from bcid.likelihood.hypothesis import Hypothesis
from bcid.likelihood.jacobian import changed_cars, on_body_and_servo, parameter_jacobian
from bcid.likelihood.marginal import MarginalTerms, robust_weights, segment_moments
from bcid.likelihood.nuisance import LinearisedHistories, about_no_pushes, linearise_histories
from bcid.likelihood.prior import Prior
from bcid.likelihood.refit import Fit
from bcid.likelihood.scale_estimate import estimate_scales
from bcid.likelihood.take import N_NUISANCE, Take
from bcid.likelihood.tracking_functions import tracking_changes
from bcid.likelihood.unnamed_functions import NO_REMAINDER
from bcid.physics.car import Car


class WeighedInformation(NamedTuple):
    """Slopes and information of n names and K functions, about no functions, the names' prior included."""

    slope_n: Floats  # (n,)
    slope_c: Floats  # (K,)
    G_n: Floats  # (n, n)
    G_nc: Floats  # (n, K)
    G_c: Floats  # (K, K)

    @property
    def quadratic(self) -> Quadratic:
        """The log-likelihood of the functions' coefficients, about none, with the names projected out."""
        answer = np.linalg.lstsq(self.G_n, self.G_nc, rcond=1e-12)[0]
        return Quadratic(self.slope_c - answer.T @ self.slope_n, self.G_c - self.G_nc.T @ answer)

    def names_beside(self, c: Floats) -> Floats:
        """The change (n,) of the names that is likeliest beside the coefficients `c` (K,)."""
        return np.asarray(np.linalg.lstsq(self.G_n, self.slope_n - self.G_nc @ c, rcond=1e-12)[0])


class TakeInformation(NamedTuple):
    """Products of S segments' residuals and derivatives at a fit: n names, Q carriers, K functions of a basis."""

    names: Floats  # (S, n, n) J^T P J
    cross: Floats  # (S, n, Q) J^T P Q
    carriers: Floats  # (S, Q, Q)
    name_slopes: Floats  # (S, n) J^T P r
    carrier_slopes: Floats  # (S, Q)
    values: Floats  # (S, Q, K) what a unit of each function does to each carrier
    terms: MarginalTerms
    prior: Prior  # of the names
    phi: Floats  # (n,) their values
    c: Floats  # (K,) coefficients of the functions at the fit
    rows: Floats  # (N, 3, N_NUISANCE + n + Q + 1) A, J, Q and r over the noise
    first: Ints  # (S + 1,) rows of the segments
    along: Floats  # (S, knots, ALONG) what the car is at in each knot
    seen_s: Floats  # (N,) times of the rows

    @property
    def robust_weights(self) -> Floats:
        """Weights (S,) of segments under Student's t at the fit."""
        return robust_weights(self.terms)

    def weigh(self, weights: Floats) -> WeighedInformation:
        """Slopes and information of names and functions, segments summed with their `weights` (S,)."""
        K = self.values.shape[2]
        G_n = np.tensordot(weights, self.names, axes=1) + np.diag(self.prior.stiffness(self.phi))
        answered = (self.carriers * weights[:, None, None]) @ self.values
        G_c = self.values.reshape(-1, K).T @ answered.reshape(-1, K)
        G_nc = np.tensordot(self.cross * weights[:, None, None], self.values, axes=((0, 2), (0, 1)))
        slope_n = weights @ self.name_slopes + self.prior.slope(self.phi) + G_nc @ self.c
        slope_c = np.tensordot(weights[:, None] * self.carrier_slopes, self.values, axes=((0, 1), (0, 1)))
        return WeighedInformation(slope_n, slope_c + G_c @ self.c, G_n, G_nc, G_c)

    def with_functions(self, basis: RemainderBasis, car: Car) -> TakeInformation:
        """The products for another `basis`, whose functions in the tracking are the same; the model holds none."""
        values = _carried_values(basis, self.along, car)
        return self._replace(values=values, c=np.zeros(values.shape[2]))

    def carried_elsewhere(self, order: Ints) -> TakeInformation:
        """The products with the forces of segment s as functions of what the segment `order[s]` went through.

        What such functions explain they explain by chance; those in the tracking do nothing.
        """
        H, B = self.along.shape[1] * ACTIONS, self.values.shape[2]
        moved = np.zeros_like(self.values)
        moved[:, :H, :B] = self.values[order, :H]
        return self._replace(values=moved)

    def with_residual(self, r: Floats) -> TakeInformation:
        """What this fit would say of a take whose residual were `r` (N, 3, over the noise), its names at their prior.

        In `terms`, which are those of the actual take, only V and its root hold for both.
        """
        rows = np.concatenate([self.rows[:, :, :-1], r[:, :, None]], axis=2)
        n, slopes = self.names.shape[1], np.empty((len(self.names), rows.shape[2] - N_NUISANCE - 1))
        for s, (a, b) in enumerate(itertools.pairwise(self.first)):
            own = rows[a:b].reshape(-1, rows.shape[2])
            root = self.terms.root[s]
            A, acting, seen = own[:, :N_NUISANCE], own[:, N_NUISANCE:-1], own[:, -1]
            slopes[s] = acting.T @ (seen - A @ (root.T @ (root @ (A.T @ seen))))
        return self._replace(
            rows=rows, name_slopes=slopes[:, :n], carrier_slopes=slopes[:, n:], phi=self.prior.centre,
            c=np.zeros_like(self.c),
        )  # fmt: skip

    def chi2_beside(self, moved: Floats, c: Floats) -> Floats:
        """The chi^2 of each segment, the names `moved` (n,) and the coefficients at `c` (K,), to first order."""
        acts = self.values @ (c - self.c)
        linear = self.name_slopes @ moved + np.einsum("sq,sq->s", self.carrier_slopes, acts)
        square = np.einsum("i,sij,j->s", moved, self.names, moved)
        square += 2.0 * np.einsum("i,siq,sq->s", moved, self.cross, acts, optimize=True)
        square += np.einsum("sq,sqp,sp->s", acts, self.carriers, acts, optimize=True)
        return np.asarray(np.maximum(self.terms.chi2 - 2.0 * linear + square, 0.0))


def gather_information(fit: Fit, take: Take, basis: RemainderBasis, c: Floats) -> TakeInformation:
    """The products of all segments at a `fit` that holds the coefficients `c` (K,) of the functions in the `basis`."""
    h = fit.hypothesis
    named = replace(h, remainder=NO_REMAINDER)
    n, phi = named.named_size, fit.phi[: named.named_size]
    at, J = _linearise(fit, take, named)
    r = about_no_pushes(at.r, at.A, fit.start, take.first)
    _, terms = estimate_scales(segment_moments(r, at.A, take.first), fit.scales, 0)
    seen = tracking_changes(basis.tracking, at.poses, take.seen_rows)
    rows = np.concatenate([at.A, J, at.history.D, seen, r[:, :, None]], axis=2) / fit.scales.r[:, None]
    products = _project_out_nuisance(rows, terms.root, take)
    values = _carried_values(basis, at.history.along, fit.car())
    own, carried = slice(n), slice(n, n + values.shape[1])
    return TakeInformation(
        products[:, own, own], products[:, own, carried], products[:, carried, carried], products[:, own, -1],
        products[:, carried, -1], values, terms, named.prior(phi), phi, c, rows, take.first,
        at.history.along, take.seen_rows.time_s,
    )  # fmt: skip


def _carried_values(basis: RemainderBasis, along: Floats, car: Car) -> Floats:
    """What a unit of each function of a `basis` does to each carrier (S, Q, K), the car being at what is `along`."""
    acting = history_values(basis.functions, along, car)
    S, H, B, M = *acting.shape, len(basis.tracking)
    values = np.zeros((S, H + M, B + M))
    values[:, :H, :B] = acting
    values[:, H:, B:] = np.eye(M)
    return values


def _linearise(fit: Fit, take: Take, named: Hypothesis) -> tuple[LinearisedHistories, Floats]:
    """Residuals and derivatives by histories, and by names (N, 3, n), at a fit."""
    h = fit.hypothesis
    at = linearise_histories(take, h.prediction_inputs(fit.phi, take), fit.start, changed_cars(h, fit.phi))
    base = on_body_and_servo(take, h, fit.phi, fit.start, at.r, at.J)
    effects = parameter_jacobian(take, h, fit.phi, fit.start, at.r, range(named.base_size, named.named_size))
    return at, np.concatenate([base, effects], axis=2)


def _project_out_nuisance(rows: Floats, root: Floats, take: Take) -> Floats:
    """Products (S, q, q) of the columns of `rows` (N, 3, N_NUISANCE + q) after the first, those projected out."""
    first = take.first
    q = rows.shape[2] - N_NUISANCE
    out = np.empty((take.segments, q, q))
    for s, (a, b) in enumerate(itertools.pairwise(first)):
        own = rows[a:b].reshape(-1, N_NUISANCE + q)
        free = root[s] @ (own[:, :N_NUISANCE].T @ own[:, N_NUISANCE:])
        out[s] = own[:, N_NUISANCE:].T @ own[:, N_NUISANCE:] - free.T @ free
    return out
