"""The simulation that a recording is compared with: another's recording, a saved model, a user's function."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from cars import CAR

from bcid.diagnosis.base_parameters import describe_base_parameters
from bcid.diagnosis.diagnose import diagnose_recordings
from bcid.diagnosis.reference import (
    identify_reference,
    load_user_model,
    reference_from_model,
    reference_from_parameters,
    simulate_with_model,
)
from bcid.diagnosis.reference_model import ReferenceModel
from bcid.diagnosis.search.refits import fitted_corrections
from bcid.effects.constants import Constants
from bcid.effects.table import effect_ids
from bcid.errors import InputRefused, UsageError
from bcid.estimate.run import estimate_motion
from bcid.estimate.tuning import Tuning
from bcid.estimate.types import Estimate
from bcid.likelihood.hypothesis import DRAG, SPEED_LAW, TYRES, Hypothesis
from bcid.likelihood.limits import LIKELIHOOD_LIMITS
from bcid.likelihood.prepare import base_hypothesis
from bcid.likelihood.refit import Fit
from bcid.likelihood.refit_state import Tangent
from bcid.likelihood.scales import Scales
from bcid.models import published
from bcid.models.saving import save_model
from bcid.proof.blind.concealed_effects import draw_outside_effect
from bcid.recording.read import read_recording
from bcid.recording.types import Recording
from bcid.simulation.car import Plant, Sensor
from bcid.simulation.samples import SampleTake, write_sample_take
from bcid.vehicle import Vehicle

ROUGH = {"rough_force": 3.0, "rough_moment": 1.5}


def taken(
    folder: Path, vehicle: Vehicle, tuning: Tuning, plant: Plant, seed: int, seconds: float = 120.0
) -> tuple[Recording, Estimate]:
    path = write_sample_take(folder, SampleTake(f"take{seed}", "mcap", seconds), plant, Sensor(), seed)
    recording = read_recording(path, vehicle)
    return recording, estimate_motion(recording, vehicle, tuning)


@pytest.mark.proof
def test_only_what_the_simulator_lacks_is_named(tmp_path: Path, vehicle: Vehicle, tuning: Tuning) -> None:
    """Both cars scrub; only the real one has a dragging bearing."""
    simulator = taken(tmp_path, vehicle, tuning, Plant(yaw_scrub=16.0), 1)
    real = taken(tmp_path, vehicle, tuning, Plant(**ROUGH, yaw_scrub=16.0, rear_rolling_coulomb=28.0), 2)
    against = identify_reference([simulator[0]], [simulator[1]], vehicle)
    assert effect_ids(against.effects) == ("yaw_scrub",)
    assert against.effects["yaw_scrub__c"] == pytest.approx(16.0, rel=0.1)
    found = diagnose_recordings([real[0]], [real[1]], vehicle, against)
    assert [f.effect for f in found.judgement.findings] == ["rear_rolling_coulomb"]
    assert found.fit.effect_estimates()["yaw_scrub__c"][0] == pytest.approx(16.0, rel=0.1)


@pytest.mark.proof
@pytest.mark.parametrize(("k", "name"), [(2, "rear_roll_steer"), (4, "steering_reaction"), (5, "motor_ripple")])
def test_what_has_no_name_gets_none_beside_a_trusted_simulation(
    k: int, name: str, tmp_path: Path, vehicle: Vehicle, tuning: Tuning
) -> None:
    """Whose figures are three per cent off and trusted as if they were two."""
    hidden, rng = draw_outside_effect(name, np.random.default_rng(3 + k)), np.random.default_rng(k)
    recording, estimate = taken(tmp_path, vehicle, tuning, Plant(**ROUGH, **hidden.plant), 11 + k, 180.0)
    known = (*SPEED_LAW, *TYRES, "R_1")
    car = CAR._replace(**{s: getattr(CAR, s) * float(np.exp(0.03 * rng.normal())) for s in known})
    found = diagnose_recordings([recording], [estimate], vehicle, ReferenceModel(car, {}, 0.02)).judgement
    assert found.findings == ()
    assert found.verdict == "unknown"


def test_a_function_s_model_drives_the_recording_s_commands(
    tmp_path: Path, vehicle: Vehicle, tuning: Tuning, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The published car, as a user's function, goes nearly where the simulated one went; set anew every 20 s."""
    (tmp_path / "my_car.py").write_text(
        "from bcid.models import published\n\ndef model():\n    return published.newton_euler()\n", encoding="utf-8"
    )
    monkeypatch.chdir(tmp_path)
    recording, estimate = taken(tmp_path, vehicle, tuning, Plant(), 3, 60.0)
    driven = simulate_with_model(load_user_model("my_car:model"), recording, estimate)
    assert len(driven.poses.time_s) == sum(s.stop - s.start for s in estimate.segments())
    rows = np.searchsorted(estimate.time_s, driven.poses.time_s)
    apart = np.hypot(*(driven.poses.values[:, :2] - estimate.pose[rows, :2]).T)
    assert 1e-4 < np.median(apart) < 0.5
    anew = np.searchsorted(driven.poses.time_s, driven.breaks_s)
    assert len(anew) >= 2
    np.testing.assert_allclose(apart[anew], 0.0, atol=1e-9)
    with pytest.raises(UsageError, match=r"steps by 0\.1 s, the grid by 0\.05 s"):
        simulate_with_model(load_user_model("my_car:model"), recording, replace(estimate, period_s=0.05))


def test_a_saved_model_says_what_it_has(tmp_path: Path) -> None:
    for name, model in (("car", published.newton_euler()), ("black_box", published.k_sindy())):
        (tmp_path / name).mkdir()
        save_model(model, tmp_path / name)
    assert reference_from_model(tmp_path / "car").car == published.newton_euler().car
    assert reference_from_model(tmp_path / "car").effects == {}
    with pytest.raises(InputRefused, match="no forces"):
        reference_from_model(tmp_path / "black_box")


@pytest.mark.parametrize(
    ("name", "says"),
    [
        (":f", "neither a file or folder nor module:function"),
        ("..x:f", "neither a file or folder nor module:function"),
        ("missing.mcap", "neither a file or folder nor module:function"),
        ("no_such_module_here:f", "No module named"),
        ("math:no_such_function", "no attribute"),
        ("math:sqrt", "TypeError"),
        ("time:time", "has no init, step, period_s"),
        ("broken_car:model", "SyntaxError"),
    ],
)
def test_what_is_no_simulation_is_refused(
    name: str, says: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "broken_car.py").write_text("def model(:\n", encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    with pytest.raises(UsageError, match=says) as told:
        load_user_model(name)
    assert "next:" in str(told.value)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"K_t": -1.0}, "needs above zero K_t"),
        ({"I_z": 0.0}, "needs above zero I_z"),
        ({"T_s": 0.2}, "has in the vehicle file already T_s"),
        ({"mass": 1.0}, "has unknown mass"),
        ({"C_f": None}, "lacks C_f"),
    ],
)
def test_a_file_of_parameters_that_no_car_has_is_refused(
    change: dict[str, float | None], says: str, tmp_path: Path, estimates: list[Estimate], vehicle: Vehicle
) -> None:
    values = {s: getattr(CAR, s) for s in (*SPEED_LAW, *TYRES, *DRAG)} | change
    lines = [f"{s} = {v!r}" for s, v in values.items() if v is not None]
    (tmp_path / "sim.toml").write_text("\n".join(["[parameters]", *lines]), encoding="utf-8")
    with pytest.raises(InputRefused, match=says):
        reference_from_parameters(tmp_path / "sim.toml", estimates, vehicle)


def test_only_what_is_published_is_trusted(tmp_path: Path, estimates: list[Estimate], vehicle: Vehicle) -> None:
    """What neither file says of the servo is the estimate's own of this take."""
    lines = [f"{s} = {getattr(CAR, s)!r}" for s in (*SPEED_LAW, *TYRES, *DRAG)]
    text = "\n".join(["relative_sd = 0.02", "relative_sd_of = {{ K_t = 0.05 }}", "[parameters]", *lines])
    steering = vehicle.steering.model_copy(update={"time_constant_s": None, "max_rate_radps": None})
    unsaid = vehicle.model_copy(update={"steering": steering})
    for said in ("", f"T_s = {CAR.T_s}"):
        (tmp_path / "sim.toml").write_text(text.format() + "\n" + said, encoding="utf-8")
        against = reference_from_parameters(tmp_path / "sim.toml", estimates, unsaid)
        hypothesis = base_hypothesis(unsaid, against.car, estimates, ()).trust_simulation(
            [], 0.02, against.relative_sd_of
        )
        assert hypothesis.trusted_simulation is not None
        sd = dict(zip(hypothesis.log_parameters, hypothesis.trusted_simulation.sd, strict=False))
        assert (sd["K_t"], sd["C_f"], sd["d"]) == (0.05, 0.02, LIKELIHOOD_LIMITS.base_prior_sd)
        assert sd["T_s"] == (0.02 if said else LIKELIHOOD_LIMITS.base_prior_sd)


def test_an_effect_beyond_its_bounds_is_refused_not_clipped(
    tmp_path: Path, estimates: list[Estimate], vehicle: Vehicle
) -> None:
    lines = [f"{s} = {getattr(CAR, s)!r}" for s in (*SPEED_LAW, *TYRES, *DRAG)]
    text = "\n".join(["[parameters]", *lines, "[effects]", "motor_delay = {{ tau = {} }}"])
    (tmp_path / "sim.toml").write_text(text.format(0.05), encoding="utf-8")
    assert reference_from_parameters(tmp_path / "sim.toml", estimates, vehicle).effects == {"motor_delay__tau": 0.05}
    (tmp_path / "sim.toml").write_text(text.format(50.0), encoding="utf-8")
    with pytest.raises(InputRefused, match="tau = 50 lies outside"):
        reference_from_parameters(tmp_path / "sim.toml", estimates, vehicle)


def test_what_has_gone_as_far_as_any_car_s_goes_is_told() -> None:
    """Of the base model, and of what the simulation has; what is found beside is told with the findings."""
    known = Hypothesis((), CAR, 2.012, Constants(), assumed=("motor_lag", "yaw_scrub")).trust_simulation(
        [0.06, 13.0], 0.02
    )
    held = known.with_effects("motor_delay")
    low, high = held.bounds()
    phi = held.phi_of(CAR, [0.06, 13.0, 0.05])
    C_f, scrub = held.log_parameters.index("C_f"), held.base_size + 1
    phi[C_f], phi[scrub] = low[C_f], high[scrub]
    scales, tangent = Scales(np.ones(3), np.ones(3)), Tangent(np.empty(0), np.empty(0))
    fit = Fit(held, phi, np.empty(0), scales, 0.0, np.zeros(9), 1e-6 * np.eye(len(phi)), tangent)
    rows = {row.symbol: row for row in describe_base_parameters(fit)}
    assert [s for s, row in rows.items() if row.at_bound] == ["C_f", "yaw_scrub.c"]
    assert list(rows)[-2:] == ["motor_lag.tau", "yaw_scrub.c"]
    assert rows["motor_lag.tau"].value == pytest.approx(0.06)
    assert rows["yaw_scrub.c"].unit == "kg m^2 s^-1 rad^-1"


@pytest.mark.parametrize("assumed", [(), ("steering_scale",)])
def test_the_gain_of_raw_commands_is_told_once(assumed: tuple[str, ...]) -> None:
    """With the base model where that assumes it, otherwise as a correction of it."""
    held = Hypothesis((), CAR, 2.012, Constants(), assumed=assumed, raw_commands=True).with_effects("steering_scale")
    phi = held.phi_of(CAR, [0.03])
    scales, tangent = Scales(np.ones(3), np.ones(3)), Tangent(np.empty(0), np.empty(0))
    fit = Fit(held, phi, np.empty(0), scales, 0.0, np.zeros(9), 1e-6 * np.eye(len(phi)), tangent)
    in_base = [row.symbol for row in describe_base_parameters(fit) if row.symbol == "steering_scale.g"]
    assert in_base == ["steering_scale.g"] * len(assumed)
    assert fitted_corrections(fit) == (() if assumed else ("steering_scale",))
