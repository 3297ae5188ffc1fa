"""The two models that the paper publishes with their numbers: they check the equations against each other."""

import numpy as np

from bcid.models.kinematic.k_sindy import KSindy
from bcid.models.kinematic.library import SLIP_TERMS, SPEED_TERMS_PUBLISHED
from bcid.models.kinematic.sparse_sum import SparseEquations
from bcid.models.kinematic.state import KinematicCar
from bcid.models.newton_euler.model import NewtonEuler
from bcid.physics.car import Car


def newton_euler() -> NewtonEuler:
    """Build the Newton-Euler model with the paper's published constants (Table `parameters`), in steps of 0.1 s.

    The paper does not print v_0, the least rolling speed in a slip angle: 1 m/s (docs/errata.md row 14).
    """
    car = Car(
        m=319.6, I_z=90.85, l_f=0.54, l_r=0.33, T_s=0.155, d=1.418, F_m_max=423.4, K_t=274.8, K_b=597.0,
        C_f=3594.0, C_r=7840.0, F_f_max=629.6, F_r_max=1360.0, R_1=43.40, R_2=-15.61, v_0=1.0,
    )  # fmt: skip
    return NewtonEuler(car, 0.1, {"optimiser": "as published"})


def k_sindy() -> KSindy:
    """Build K-SINDy, sparse equations of the kinematic state, with the paper's published coefficients (App. sindy).

    The paper's u_m c is our u_m (m/s), and the braking term is min(0, u_m) v_f (docs/errata.md rows 8, 16).
    """
    xi_v = np.array([0.053, 0.053 * 0.487, 0.181, -0.181 * 0.462, 0.968, 0.0379, -0.0155, *[0.0] * 9])
    xi_v[9] = -0.475  # alpha_f^2
    #                AF     AR     vδ        vδ|δ|     v²δ      vδ̇     vδ̇|δ̇|   v²δ̇    vδ|δ̇| vδ̇|δ|     vδ̇δ²
    xi_f = np.array([0.777, 0.0, 0.0, 0.00718, -0.0117, 0.0259, -0.0169, -0.0169, 0.0, 0.0, -0.00836])
    xi_r = np.array([-0.0485, 0.0, 0.0147, -0.0127, 0.0, 0.0, 0.0, 0.0, 0.0, -0.00661, 0.00580])
    car = KinematicCar(0.54, 0.33, 0.155, 1.418, 0.1)
    return KSindy(SparseEquations(xi_v, xi_f, xi_r, SPEED_TERMS_PUBLISHED, SLIP_TERMS), car, {"library": "published"})
