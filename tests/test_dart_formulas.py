"""The car of pipelines/dart/simulation.toml is the one that the DART's authors publish."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import dart_authors as authors
import numpy as np
import pytest
from dart_formulas import RESULT, formula_table, grid

PAGE = Path(__file__).parents[1] / "docs" / "dart.md"


def rows_of(table: list[dict[str, Any]], force: str, where: str = "") -> list[dict[str, Any]]:
    found = [row for row in table if force in row["force"] and where in row["where"]]
    assert found, (force, where)
    return found


def test_the_committed_table_is_that_of_the_compiled_car() -> None:
    for now, then in zip(formula_table(), json.loads(RESULT.read_text(encoding="utf-8")), strict=True):
        assert now == pytest.approx(then, abs=0.02)


def test_the_car_is_within_two_percent_of_the_authors_forces() -> None:
    """Of each force's full scale, where the drives are; side forces, which have another form, in the mean only."""
    table = json.loads(RESULT.read_text(encoding="utf-8"))
    exact = [
        *rows_of(table, "motor", "throttle 0 to 0.6"), *rows_of(table, "motor", "from 0.2"),
        *rows_of(table, "resistance straight"), *rows_of(table, "resistance by", "0.4 to 2 m/s"),
        *rows_of(table, "force along"),
    ]  # fmt: skip
    assert len(exact) == 5
    assert max(row["largest_percent"] for row in exact) < 2.0
    sides = [*rows_of(table, "side force"), *rows_of(table, "force across"), *rows_of(table, "moment")]
    assert len(sides) == 6
    assert max(row["rms_percent"] for row in sides) < 2.0
    assert max(row["largest_percent"] for row in rows_of(table, "side force")) < 2.75
    # what stood there before was no such drag
    assert rows_of(table, "2.2 |angle|")[0]["rms_percent"] > 20.0


def test_the_page_tells_how_near_the_car_is() -> None:
    table, page = json.loads(RESULT.read_text(encoding="utf-8")), " ".join(PAGE.read_text(encoding="utf-8").split())

    def worst(force: str, where: str = "") -> tuple[float, float]:
        rows = rows_of(table, force, where)
        return max(r["rms_percent"] for r in rows), max(r["largest_percent"] for r in rows)

    (published,) = rows_of(table, "resistance by", "0.4 to 2 m/s")
    assert f"within {published['largest_percent']:.1f} % of its full scale of {published['full_scale']:.1f} N" in page
    mean, largest = worst("2.2 |angle|")
    assert f"off by {mean:.1f} % of that in the mean and {largest:.1f} % at most" in page
    mean, largest = worst("side force")
    assert f"side forces within {mean:.1f} % in the mean and {largest:.1f} % at most" in page
    for force, name in (("force across", "all that acts across the car"), ("moment", "the moment")):
        mean, largest = worst(force)
        assert f"{name} {mean:.1f} and {largest:.1f} %" in page
    assert f"({worst('wheel angle')[1]:.1f} % of full lock from theirs at most)" in page
    assert max(worst(f)[1] for f in ("resistance straight", "force along")) < 1.0


def test_the_authors_formulas_give_what_is_known_of_their_car() -> None:
    """The ends of the steering's map, both drags at once, the tyres' slopes, and the axles' loads."""
    assert authors.wheel_angle(np.array([1.0, -1.0])) == pytest.approx([0.320, -0.403], abs=5e-4)
    delta, v = grid(np.linspace(0.05, 0.385, 68), np.linspace(0.4, 2.0, 161))
    off = authors.steering_resistance(delta, v) - delta * (3.63 + 1.24 * v)
    assert np.sqrt(np.mean(off**2)) < 0.05
    slip = np.array([1e-5])
    slopes = [float(law(slip)[0] / -1e-5) for law in (authors.front_side_force, authors.rear_side_force)]
    assert slopes == pytest.approx([50.5, 68.1], rel=2e-3)
    np.testing.assert_allclose([authors.L_F, authors.L_R], [0.0805, 0.0930], atol=1e-4)


def test_a_turn_that_the_authors_car_holds_needs_no_more_side_force_than_its_way_does() -> None:
    turns = authors.steady_turns(np.array([0.5, 1.5]), np.array([0.2, -0.3]))
    F_x, F_y, M_z = authors.wrench(*turns)
    np.testing.assert_allclose(F_y, authors.MASS * turns.omega * turns.v_x, atol=1e-8)
    np.testing.assert_allclose(F_x, -authors.MASS * turns.omega * turns.v_y, atol=1e-8)
    np.testing.assert_allclose(M_z, 0.0, atol=1e-9)
    # slowly it rolls about a point beside the rear axle
    assert turns.omega[0] == pytest.approx(0.5 * np.tan(0.2) / authors.WHEELBASE, rel=0.05)
