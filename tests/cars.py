"""The bumper car of the tests."""

from __future__ import annotations

from bcid.physics.car import Car

CAR = Car(
    m=319.6, I_z=90.85, l_f=0.54, l_r=0.33, T_s=0.155, d=1.418, F_m_max=423.4, K_t=274.8, K_b=597.0, C_f=3594.0,
    C_r=7840.0, F_f_max=629.6, F_r_max=1360.0, R_1=43.4, R_2=4.0, v_0=1.0,
)  # fmt: skip
