"""Takes that cannot show what is to be fitted are refused by the constants' names."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bcid.errors import InputRefused
from bcid.estimate.types import Estimate
from bcid.models.fitting.windows import check_excitation


def test_usual_takes_are_not_refused(estimates: list[Estimate]) -> None:
    check_excitation(estimates)


@pytest.mark.parametrize(("keep", "names"), [((1.0, 1.0, 0.0), "C_f, C_r"), ((0.0, 0.0, 0.0), "K_t, R_1")])
def test_what_cannot_be_identified_is_named(
    keep: tuple[float, float, float], names: str, estimates: list[Estimate]
) -> None:
    poor = [replace(e, twist=e.twist * np.array(keep)) for e in estimates]
    with pytest.raises(InputRefused, match=names):
        check_excitation(poor)


def test_one_take_that_shows_it_is_enough(estimates: list[Estimate]) -> None:
    check_excitation([replace(estimates[0], twist=0.0 * estimates[0].twist), estimates[1]])
