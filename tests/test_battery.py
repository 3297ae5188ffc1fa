"""A short form of `python -m faults battery`: edits of everything that is saved, loaded and driven; and by name."""

from __future__ import annotations

import json
import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from cars import CAR
from faults.battery import FAILURES, run_battery
from faults.saved import models, seal_model
from safetensors.numpy import load_file, save_file

from bcid.errors import InputRefused
from bcid.evaluation.validity import load_validity
from bcid.files.json import read_json
from bcid.files.parquet import read_columns, write_columns
from bcid.models.kinematic.saved_kinematics import SavedKinematicCar
from bcid.models.kinematic.state import KinematicCar
from bcid.models.newton_euler.saved_car import SavedCar
from bcid.models.saving import load_model, save_model
from bcid.models.table import MODELS
from bcid.physics.car import Car
from bcid.store.artifact import file_sha256

EDITS = 8  # of each kind


@pytest.mark.slow
@pytest.mark.filterwarnings("default")
def test_edits_of_all_that_is_saved_are_refused_by_name_or_give_numbers() -> None:
    outcomes = list(run_battery(EDITS))
    assert [o for o in outcomes if o.what in FAILURES] == []
    assert len(outcomes) > 25 * EDITS
    assert sum(o.what == "refused" for o in outcomes) > len(outcomes) / 2


def test_every_model_is_in_the_battery() -> None:
    assert {m.name for m in models().values()} == set(MODELS)


@pytest.mark.parametrize("name", models())
def test_what_is_saved_is_loaded_as_it_was(name: str, tmp_path: Path) -> None:
    model = models()[name]
    save_model(model, tmp_path)
    again = load_model(tmp_path)
    assert again.describe() == model.describe()
    data, arrays = model.to_saved()
    data_again, arrays_again = again.to_saved()
    assert json.loads(json.dumps(data_again)) == json.loads(json.dumps(data))
    assert all(np.array_equal(arrays[k], arrays_again[k]) for k in arrays | arrays_again)


def test_the_saved_cars_have_all_constants_of_theirs() -> None:
    assert tuple(SavedCar.model_fields) == Car._fields
    assert tuple(SavedKinematicCar.model_fields) == KinematicCar._fields
    assert SavedCar.model_validate(CAR._asdict()).to_car() == CAR
    for saved, plain in ((SavedCar, Car), (SavedKinematicCar, KinematicCar)):
        defaults = {k: f.default for k, f in saved.model_fields.items() if not f.is_required()}
        assert defaults == plain._field_defaults


def with_arrays(folder: Path, **changed: np.ndarray) -> Path:
    """The K-SINDy in `folder` with other arrays, and a digest that is right."""
    save_model(models()["k-sindy"], folder)
    path = folder / "arrays.safetensors"
    save_file({**load_file(path), **changed}, path)
    seal_model(folder / "model.json", read_json(folder / "model.json") | {"arrays_sha256": file_sha256(path)}, {})
    return folder


def test_exponents_by_which_a_kernel_writes_are_bounded(tmp_path: Path) -> None:
    """A row with a negative exponent, whose sum is small, has more factors than its sum: they were written beyond."""
    save_model(models()["k-sindy"], tmp_path)
    slip = load_file(tmp_path / "arrays.safetensors")["slip"]
    for row in ([5_000_000, -5_000_000, *[0] * 8], [9, *[0] * 9], [2] * 10):
        with pytest.raises(InputRefused, match="array slip"):
            load_model(with_arrays(tmp_path, slip=np.array([row] * len(slip), np.int64)))
    with pytest.raises(InputRefused, match="array slip: is of int32"):
        load_model(with_arrays(tmp_path, slip=slip.astype(np.int32)))
    with pytest.raises(InputRefused, match=r"array slip: has the shape \(10, 10\)"):
        load_model(with_arrays(tmp_path, slip=slip[:10].copy()))
    with pytest.raises(InputRefused, match="array xi_f: holds a number that is not finite"):
        load_model(with_arrays(tmp_path, slip=slip, xi_f=np.full(len(slip), np.nan)))


@pytest.mark.parametrize(
    ("place", "value", "told"),
    [
        (("period_s",), 0.0, "period_s"), (("period_s",), "0_1.5", "period_s"), (("period_s",), True, "period_s"),
        (("car", "m"), "heavy", r"car\.m"), (("car", "m"), -1.0, r"car\.m"), (("car", "T_s"), 0.0, r"car\.T_s"),
        (("car", "front_share"), 2.0, r"car\.front_share"), (("car", "sets_force"), 0.5, r"car\.sets_force"),
        (("car", "K_tt"), 1.0, "perhaps K_t"), (("facts", "fitted"), {"C_x": None}, r"facts\.fitted\.C_x"),
    ],
)  # fmt: skip
def test_a_wrong_value_is_named_with_its_place_and_a_next_step(
    place: tuple[str, ...], value: Any, told: str, tmp_path: Path
) -> None:
    save_model(models()["newton-euler"], tmp_path)
    data = read_json(tmp_path / "model.json")
    inner = data
    for key in place[:-1]:
        inner = inner[key]
    inner[place[-1]] = value
    seal_model(tmp_path / "model.json", data, {})
    with pytest.raises(InputRefused, match=told) as caught:
        load_model(tmp_path)
    assert str(tmp_path) in str(caught.value)
    assert "next: " in str(caught.value)


def test_facts_of_a_model_without_a_fit_are_described(tmp_path: Path) -> None:
    """Facts that were written by hand, or by an earlier version: what is not stated is not printed."""
    facts = {"optimiser": "by hand", "fitted": {"C_f": {"unit": "N", "meaning": "stiffness", "relative_se": 0.1}}}
    save_model(replace(models()["newton-euler"], facts=facts), tmp_path)  # type: ignore[type-var]
    assert "by hand" in load_model(tmp_path).describe()


@pytest.mark.parametrize("name", ["model.json", "arrays.safetensors", "limits.json"])
def test_a_pipe_in_a_models_folder_is_not_waited_for(name: str, tmp_path: Path) -> None:
    save_model(models()["k-sindy"], tmp_path)
    (tmp_path / name).unlink(missing_ok=True)
    os.mkfifo(tmp_path / name)
    with pytest.raises(InputRefused, match="regular file"):
        (load_validity if name == "limits.json" else load_model)(tmp_path)


def test_a_table_of_ours_holds_finite_numbers_of_double_precision(tmp_path: Path) -> None:
    path, units = tmp_path / "t.parquet", {"time": "s", "x": "m"}
    write_columns(path, np.array([[0.0, 1.0], [1.0, np.nan]]), units)
    with pytest.raises(InputRefused, match="column x: is nan in row 2"):
        read_columns(path, units)
    assert np.isnan(read_columns(path, units, undefined=["x"])[1, 1])
    write_columns(path, np.empty((0, 2)), units)
    with pytest.raises(InputRefused, match="0 rows"):
        read_columns(path, units)
    # as others write what is not there, in several groups of rows
    column = pa.chunked_array([[0.5, None], [2.5]], pa.float64())
    pq.write_table(pa.table({"time": [0.0, 1.0, 2.0], "x": column}), path, row_group_size=2)
    np.testing.assert_array_equal(read_columns(path, units, ["x"]), [[0.0, 0.5], [1.0, np.nan], [2.0, 2.5]])
    with pytest.raises(InputRefused, match="column x: is nan in row 2"):
        read_columns(path, units)
