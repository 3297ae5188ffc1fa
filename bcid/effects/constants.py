"""The small constants in the effects' equations, with their units; they are not fitted."""

from typing import NamedTuple


class Constants(NamedTuple):
    """Constants in the effects' equations, SI."""

    v_c: float = 0.05  # m/s, speed over which Coulomb friction builds up
    w_c: float = 0.05  # rad/s, the same for turning
    v_p: float = 0.2  # m/s, least speed in a power limit
    track: float = 0.6  # m, between the rear wheels; the vehicle file's where it is given
