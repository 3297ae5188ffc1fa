"""One small specimen of everything that bcid saves: where it lies, how it is edited with digests made right, and used.

A use loads the folder as the commands do, and drives what it holds: models roll out, documents are printed.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from making import circling_take

from bcid.cli import show
from bcid.cli.app import app
from bcid.cli.options import Format
from bcid.cli.sink import Sink
from bcid.documents.diagnosis import DiagnosisDocument
from bcid.documents.health import HealthDocument
from bcid.documents.manifest import ManifestDocument
from bcid.documents.prove import ProveDocument
from bcid.documents.report import EvaluationDocument, ReportDocument
from bcid.effects.constants import Constants
from bcid.effects.remainder_table import COEFFICIENT, COLUMNS, OF_THE_CAR, WAVE
from bcid.effects.remainder_table import INPUTS as INPUTS_OF_FUNCTIONS
from bcid.estimate.consistency import NeesSummary, RmseByState, TruthCheck
from bcid.estimate.run import estimate_motion
from bcid.estimate.saving import EstimateSummary, load_estimate, save_estimate
from bcid.estimate.tuning import Noise, Tuning
from bcid.evaluation.evaluate import evaluate_model
from bcid.evaluation.validity import ModelValidity, load_validity
from bcid.files.source_code import StageCode
from bcid.models import published
from bcid.models.interface import Model, history_at, history_at_rest, rollout
from bcid.models.kinematic.k_mlp import KMlp
from bcid.models.kinematic.k_sindy_mlp import KSindyMlp
from bcid.models.network.mlp import MlpWeights
from bcid.models.network.narx_mlp import INPUTS, NarxMlp
from bcid.models.newton_euler.augmented import AugmentedNewtonEuler
from bcid.models.newton_euler.linear import NewtonEulerLinear
from bcid.models.newton_euler.unnamed_part import UnnamedPart
from bcid.models.newton_euler.with_remainder import NewtonEulerWithRemainder
from bcid.models.saving import load_model, save_model
from bcid.pipeline.stages.report import EvaluatedModel, run_report_stage
from bcid.proof.blind.blind_test import BlindTest
from bcid.proof.blind.seal import open_seals, write_seals
from bcid.recording.checks.health import assess_health
from bcid.recording.read import read_recording
from bcid.recording.saving import RecordingSummary, load_recording, save_recording
from bcid.recording.types import Stream
from bcid.simulation.samples import VEHICLE
from bcid.store.artifact import Recipe, Store
from bcid.vehicle import read_vehicle
from faults.edits import Edit, dump, edited_arrays, edits_of_json, odd_safetensors, odd_tables

STEPS = 20
RESULTS = Path(__file__).parents[2] / "docs" / "results"
TUNING = Tuning(noise=Noise(), T_s=0.155, d=1.418)
ESTIMATE_RECIPE = Recipe("estimate", {"take": "1"}, {"period_s": 0.1}, StageCode("c0de", {"numpy": "2"}), 1)


@dataclass(frozen=True)
class Saved:
    """A kind of what is saved: its folder, the file in it that is edited, the edits, and the use of it."""

    name: str
    folder: Path
    file: str
    edits: Callable[[], list[Edit]]
    use: Callable[[], Any]  # numbers that come of it; raises BcidError where it is refused

    @property
    def path(self) -> Path:
        return self.folder / self.file


def shown(what: Any) -> str:
    """What a person is shown of a result, as text."""
    with contextlib.redirect_stdout(io.StringIO()) as out:
        Sink(Format.human).result({}, lambda: what)
    return out.getvalue()


def sealed_text(data: Any, raw: dict[str, str]) -> str:
    """Text of model.json or limits.json with the digest of its content, where it has one that can be computed."""
    content = {k: v for k, v in data.items() if k != "sha256"} if isinstance(data, dict) else data
    if isinstance(data, dict) and "sha256" in data and not raw:
        with contextlib.suppress(ValueError):
            text = json.dumps(json.loads(dump(content, {})), sort_keys=True, separators=(",", ":"))
            content = {**content, "sha256": hashlib.sha256(text.encode()).hexdigest()}
    return dump(content, raw)


def seal_model(path: Path, data: Any, raw: dict[str, str]) -> None:
    """Write model.json or limits.json with the digest of its content made right."""
    path.write_text(sealed_text(data, raw), encoding="utf-8")


def write_plain(path: Path, data: Any, raw: dict[str, str]) -> None:
    path.write_text(dump(data, raw), encoding="utf-8")


def json_edits(path: Path, seal: Callable[[Path, Any, dict[str, str]], None]) -> list[Edit]:
    return edits_of_json(json.loads(path.read_text(encoding="utf-8")), seal)


def array_edits(folder: Path) -> list[Edit]:
    """Edits of a model's arrays, whose digest in model.json is made right."""
    from safetensors.numpy import load_file, save

    def seal(content: bytes, path: Path) -> None:
        path.write_bytes(content)
        data = json.loads((path.parent / "model.json").read_text())
        data["arrays_sha256"] = hashlib.sha256(content).hexdigest()
        seal_model(path.parent / "model.json", data, {})

    path = folder / "arrays.safetensors"
    edits = [
        Edit(name, how, partial(seal, save(arrays)))
        for name, how, arrays in edited_arrays(load_file(path))
        if arrays or name != "further"
    ]
    return edits + [Edit("safetensors", how, partial(seal, data)) for how, data in odd_safetensors(path.read_bytes())]


def table_edits(path: Path) -> list[Edit]:
    """Edits of one of our own Parquet tables, with page checksums that are right."""

    def write(table: pa.Table, file: Path) -> None:
        pq.write_table(table, file, compression="zstd", write_page_checksum=True)

    return [Edit(column, how, make) for column, how, make in odd_tables(path, write)]


def drive(folder: Path) -> Any:
    """All that the commands do with a saved model: describe it, roll it out, and simulate with it."""
    model, validity = load_model(folder), load_validity(folder)
    commands = np.tile([0.2, 1.0], (STEPS, 1))
    twist = rollout(model, history_at_rest(model.lags), commands)
    carry = model.init(history_at_rest(model.lags))
    many = model.scan_many(np.tile(carry, (3, 1)), np.tile(commands, (3, 1, 1)))[1]
    step = model.step(carry, commands[0])[1]
    text = model.describe() + str(model.parameter_count) + str(model.period_s)
    if validity is not None:
        validity.range.first_exits(twist[:-1], commands)
    simulated = _command("simulate", "drive", "--model", str(folder), "--commands", str(folder.parent / "c.csv"),
                         "--out", str(folder.parent / "out"), "--force", "--format", "json")  # fmt: skip
    return {"twist": twist, "many": many, "step": step, "text": text, "simulated": simulated}


def _command(*words: str) -> str:
    """What a command prints; an error that it ends by is raised."""
    with contextlib.redirect_stdout(io.StringIO()) as out, contextlib.redirect_stderr(io.StringIO()):
        app(list(words), standalone_mode=False)
    return out.getvalue()


def weights(inputs: int) -> MlpWeights:
    rng = np.random.default_rng(1)
    W1, W2, W3 = (0.1 * rng.standard_normal(s).astype(np.float32) for s in ((inputs, 8), (8, 4), (4, 3)))
    b1, b2, b3 = (np.zeros(n, np.float32) for n in (8, 4, 3))
    return MlpWeights(np.zeros(inputs), np.ones(inputs), W1, b1, W2, b2, W3, b3, np.zeros(3), np.ones(3))


def unnamed_part() -> UnnamedPart:
    """What has no name: half a wave over the speeds, and a product of that with one over the yaw rates."""
    half_waves, functions = np.zeros((len(INPUTS_OF_FUNCTIONS), 2)), np.zeros((2, COLUMNS))
    half_waves[:2, 1] = 1.2, 0.8
    functions[:, COEFFICIENT], functions[:, WAVE] = (0.2, -0.1), 1.2
    functions[1, WAVE + 1] = 0.8
    return UnnamedPart(functions, half_waves, np.tile([-1.0, 2.0], (OF_THE_CAR, 1)))


def models() -> dict[str, Model]:
    """One of each model, with facts as fits state them."""
    base, sindy = published.newton_euler(), published.k_sindy()
    fitted = {s: {"unit": "N", "meaning": s, "relative_se": e} for s, e in (("C_f", 0.1), ("R_v", None), ("K_t", 0.9))}
    facts = {
        "optimiser": "levenberg-marquardt", "fit_quality": "good", "fitted": fitted, "at_bound": ["K_t"],
        "correlated": [["C_f", "K_t", 0.97]], "top_speed_mps": 2.0, "mass_given": False, "nmse": 0.1,
        "correlation": {"symbols": ["C_f", "K_t"], "matrix": [[1.0, 0.97], [0.97, 1.0]]},
    }  # fmt: skip
    confidence = {"v_f": {"v": [1.0, 0.9, 1.1]}, "α_f": {"α_f": [0.5, -0.1, 0.2]}}
    sindy = replace(sindy, facts={"library": "published", "term_confidence": confidence})
    force = base.car._replace(sets_force=1.0, u_0=0.05, K_v=30.0, front_share=0.3)
    effects = {"steering_delay__tau": 0.12, "rear_rolling_viscous__b": 8.0, "pose_latency__tau": 0.02}
    told = {
        "fitted": ["C_f", "R_1"], "se": {"C_f": 12.0, "rear_rolling_viscous__b": 0.3},
        "correlation": {"symbols": ["C_f", "rear_rolling_viscous__b"], "matrix": [[1.0, -0.4], [-0.4, 1.0]]},
    }  # fmt: skip
    augmented = AugmentedNewtonEuler(base.car, effects, Constants(), 0.5, 60.0, 0.1, told)
    return {
        "newton-euler": replace(base, facts=facts),
        "newton-euler, force": replace(base, car=force, facts={}),
        "newton-euler-linear": NewtonEulerLinear(base.car, 1.5, 0.1),
        "narx-mlp": NarxMlp(weights(INPUTS), 0.1, {"losses": [0.5, 0.2]}),
        "k-mlp": KMlp(weights(6), sindy.car, {}),
        "k-sindy": sindy,
        "k-sindy-mlp": KSindyMlp(sindy, weights(6), {}, dissipative=True),
        "newton-euler-augmented": augmented,
        "newton-euler-remainder": NewtonEulerWithRemainder(augmented, unnamed_part()),
    }


def saved_things(home: Path) -> list[Saved]:
    """All kinds, in folders of their own in `home`."""
    found = []
    take = circling_take(home, "drive", 12.0)
    (home / "car.toml").write_text(VEHICLE)
    (home / "c.csv").write_text("time_s,steering_rad,throttle_mps\n0.0,0.1,1.0\n0.55,0.2,1.2\n1.5,0.0,0.5\n")
    vehicle = read_vehicle(home / "car.toml")
    recording = read_recording(take, vehicle)
    speed = Stream(recording.poses.time_s, np.ones((len(recording.poses), 1)))
    recording = replace(recording, channels={"wheel_speed_mps": speed}, breaks_s=(4.0,))
    estimate = estimate_motion(recording, vehicle, TUNING)

    def folder_of(name: str) -> Path:
        made = home / name.replace(" ", "_").replace(",", "")
        made.mkdir(parents=True)
        return made

    def add(
        name: str, folder: Path, file: str, use: Callable[[Path], Any],
        edits: Callable[[Path], list[Edit]] | None = None,
    ) -> None:  # fmt: skip
        chosen = edits or partial(json_edits, seal=write_plain)
        found.append(Saved(name, folder, file, lambda: chosen(folder / file), lambda: use(folder)))

    sealed = partial(json_edits, seal=seal_model)
    for name, model in models().items():
        folder = folder_of(name)
        save_model(model, folder)
        ModelValidity.measure(model, [estimate], 1).save(folder)
        add(f"{name}: model.json", folder, "model.json", drive, sealed)
        if (folder / "arrays.safetensors").exists():
            add(f"{name}: arrays", folder, "arrays.safetensors", drive, lambda path: array_edits(path.parent))
    add("limits.json", home / "newton-euler", "limits.json", drive, sealed)

    folder = folder_of("recording")
    save_recording(recording, folder)

    def use_recording(folder: Path) -> Any:
        summary, taken = RecordingSummary.read(folder / "recording.json"), load_recording(folder)
        motion = estimate_motion(taken, vehicle, TUNING)
        return {"text": shown(show.recording_tables([summary.as_json()])), "motion": motion.twist}

    add("recording.json", folder, "recording.json", use_recording)
    for name in ("poses", "commands", "channel_wheel_speed_mps"):
        add(f"recording: {name}.parquet", folder, f"{name}.parquet", use_recording, table_edits)

    folder = folder_of("estimate")
    save_estimate(estimate, folder)

    def use_estimate(folder: Path) -> Any:
        summary, moved = EstimateSummary.read(folder / "estimate.json"), load_estimate(folder)
        k = moved.segments()[0].stop // 2
        twist = rollout(published.newton_euler(), history_at(moved, k, 3), moved.command[k : k + STEPS])
        text = shown(show.estimate_tables([show.EstimatedTake(summary, folder, None)]))
        return {"text": text, "twist": twist, "steering": np.array(moved.steering_constants())}

    add("estimate.json", folder, "estimate.json", use_estimate)
    for name in sorted(p.name for p in folder.glob("*.parquet")):
        add(f"estimate: {name}", folder, name, use_estimate, table_edits)

    folder = folder_of("tuning")
    TUNING.write(folder / "tuning.json")

    def use_tuning(folder: Path) -> Any:
        return {"motion": estimate_motion(recording, vehicle, Tuning.read(folder / "tuning.json")).twist}

    add("tuning.json", folder, "tuning.json", use_tuning)

    folder = folder_of("check")
    nees = NeesSummary(mean=3.0, median=2.5, band95=(2.0, 4.0), rows=50, left_out=2)
    rmse = RmseByState(v_x=0.1, v_y=0.1, yaw_rate=0.1, v_f=0.1, alpha_f=0.1, alpha_r=0.1)
    TruthCheck(name="drive", rmse=rmse, nees_smoother=nees, nees_filter=nees).write(folder / "check.json")
    summary = EstimateSummary.read(home / "estimate" / "estimate.json")

    def use_check(folder: Path) -> Any:
        check = TruthCheck.read(folder / "check.json")
        return {"text": shown(show.estimate_tables([show.EstimatedTake(summary, folder, check)]))}

    add("check.json", folder, "check.json", use_check)
    _add_documents(home, add, folder_of)
    _add_evaluation(home, add, folder_of)
    _add_workspace(home, found, folder_of)

    folder = folder_of("health")
    HealthDocument(recordings=(assess_health(recording, vehicle),)).write(folder / "health.json")
    add("health.json", folder, "health.json", lambda f: {"text": shown(_health_text(f / "health.json"))})
    return found


def _health_text(path: Path) -> str:
    return show.health_text(HealthDocument.read(path))


def _add_documents(home: Path, add: Callable[..., None], folder_of: Callable[[str], Path]) -> None:
    """What docs/results holds of a diagnosis, a report and a blind test."""

    def use_diagnosis(folder: Path) -> Any:
        from bcid.report.verdict_words import verdict_sentence

        document = DiagnosisDocument.read(folder / "diagnosis.json")
        return {"text": shown(show.diagnosis_tables(document)) + verdict_sentence(document)}

    def use_prove(folder: Path) -> Any:
        from bcid.report.proof_page import write_proof_page

        document = ProveDocument.read(folder / "prove.json")
        write_proof_page(document, home / "prove.html")
        return {"text": shown(show.proof_tables(document))}

    def use_report(folder: Path) -> Any:
        return {"text": shown(show.comparison_table(ReportDocument.read(folder / "report.json")))}

    for name, use in (("diagnosis", use_diagnosis), ("prove", use_prove), ("report", use_report)):
        folder = folder_of(name)
        data = json.loads((RESULTS / f"{name}.json").read_text(encoding="utf-8"))
        (folder / f"{name}.json").write_text(json.dumps({k: _short(v) for k, v in data.items()}))
        add(f"{name}.json", folder, f"{name}.json", use)

    folder, test = folder_of("seals"), BlindTest(3, "salt", True)
    write_seals(test.cases[:2], "salt", folder, 0)

    def use_seals(folder: Path) -> Any:
        (folder / "answers.json").unlink(missing_ok=True)
        seal = write_seals(test.cases[:2], "salt", folder, 0)
        return {"text": seal + str(open_seals(test.cases[:2], "salt", folder))}

    add("seals.json", folder, "seals.json", use_seals)


def _short(value: Any) -> Any:
    """JSON data with no more than two entries of every list of objects, so that edits reach every field soon."""
    if isinstance(value, list):
        return [_short(v) for v in (value[:2] if value and isinstance(value[0], dict) else value)]
    return {k: _short(v) for k, v in value.items()} if isinstance(value, dict) else value


def _add_evaluation(home: Path, add: Callable[..., None], folder_of: Callable[[str], Path]) -> None:
    """A model's evaluation, and the report's page that is drawn from it."""
    folder, model = folder_of("evaluation"), home / "newton-euler"
    take = load_estimate(home / "estimate")
    evaluate_model(load_model(model), take, [take], 2.0, folder, load_validity(model))

    def use_evaluation(folder: Path) -> Any:
        EvaluationDocument.read(folder / "evaluation.json")
        judged, out = EvaluatedModel("newton-euler", {}, model, folder), home / "page"
        out.mkdir(exist_ok=True)
        takes = [(home / "recording", home / "estimate", home / "check")]
        run_report_stage(
            out, [judged], home / "estimate", takes, {"timing_repeats": 0, "restart_s": 2.0}, "car", None
        )  # fmt: skip
        return {"text": ReportDocument.read(out / "report.json").as_json()}

    add("evaluation.json", folder, "evaluation.json", use_evaluation)
    add("evaluation: rows.parquet", folder, "rows.parquet", use_evaluation, table_edits)


def _add_workspace(home: Path, found: list[Saved], folder_of: Callable[[str], Path]) -> None:
    """An artifact's manifest: the artifact is used as it was written, or made anew."""
    store = Store(folder_of("workspace"))

    def make(folder: Path) -> None:
        (folder / "data.txt").write_text("data")

    def use() -> Any:
        artifact = store.get_or_make(ESTIMATE_RECIPE, make)
        files = ManifestDocument.read(artifact.folder / "manifest.json").files
        return {"text": (artifact.folder / "data.txt").read_text() + artifact.content + str(files)}

    folder = store.get_or_make(ESTIMATE_RECIPE, make).folder
    edits = partial(json_edits, folder / "manifest.json", write_plain)
    found.append(Saved("manifest.json", folder, "manifest.json", edits, use))
