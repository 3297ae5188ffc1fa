"""The page of a diagnosis: the four verdicts, said rightly, with nothing external and nothing alive in it."""

from __future__ import annotations

import html
import io
import re
import subprocess
import sys
from html.parser import HTMLParser
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from exported_models import MODELS
from markupsafe import Markup
from rich.console import Console

from bcid.cli.show import diagnosis_tables
from bcid.documents.diagnosis import DiagnosisDocument
from bcid.effects.table import EFFECTS
from bcid.models.saving import save_model
from bcid.report import before_after_figures, diagnosis_page, disturbance, law_figures, verdict_words, where_figures
from bcid.report.disturbance import knot_variable
from bcid.report.formats import format_number, format_with_error

Floats = npt.NDArray[np.float64]
Made = tuple[dict[str, Any], dict[str, Floats], dict[str, Floats]]


def without_nulls(value: Any) -> Any:
    """What JSON holds less its nulls: a field that is absent has its default."""
    if isinstance(value, dict):
        return {k: without_nulls(v) for k, v in value.items() if v is not None}
    return [without_nulls(v) for v in value] if isinstance(value, list) else value


def reading(function: Any) -> Any:
    """The function of a document, handed what JSON holds."""
    return lambda d, *rest: function(DiagnosisDocument.model_validate(without_nulls(d)), *rest)


verdict_sentence = reading(verdict_words.verdict_sentence)
write_diagnosis_page = reading(diagnosis_page.write_diagnosis_page)
proof_pictures = reading(before_after_figures.draw_before_after_pictures)
law_pictures = reading(law_figures.draw_missing_laws)
where_pictures = reading(where_figures.draw_where_pictures)
residual_of, two_variables = reading(disturbance.choose_residual), reading(disturbance.choose_variables)

HOSTILE = '"><script>alert(1)</script><img src=x onerror="alert(2)">$\\frac{${{ 7 * 7 }}'
DURATION_S = 300.0
SVG = Markup("<svg></svg>")


def knots_of(lacking: dict[str, Floats] | None = None, vanishes: bool = True, seed: int = 0) -> dict[str, Floats]:
    """Half-second knots of a wandering car; `lacking` is what the base model does not have."""
    rng = np.random.default_rng(seed)
    drive = _drive(0.5)
    K = len(drive["time_s"])
    columns = {**drive, "segment": np.floor(np.arange(K) / 3)}
    for c, noise in (("fx", 0.05), ("fy", 0.06), ("mz", 0.07)):
        rest = rng.normal(0.0, noise, K)
        more = lacking[c] if lacking and c in lacking else np.zeros(K)
        columns[f"before_{c}"] = rest + more
        columns[f"after_{c}"] = rest + (0.0 if vanishes else 1.0) * more
    return columns


def _drive(period: float) -> dict[str, Floats]:
    t = np.arange(0.0, DURATION_S, period)
    w = 2.0 * np.pi
    x = 4.6 * np.sin(w * t / 23.7) + 1.1 * np.sin(w * t / 9.1)
    y = 2.3 * np.sin(w * t / 14.9 + 0.4) + 1.0 * np.sin(w * t / 8.3)
    vx, vy = np.gradient(x, t), np.gradient(y, t)
    heading = np.unwrap(np.arctan2(vy, vx))
    speed, yaw_rate = np.hypot(vx, vy), np.gradient(heading, t)
    steering = np.clip(0.9 * yaw_rate, -1.8, 1.8)
    return {
        "time_s": t, "x": x, "y": y, "heading": heading, "v_x": speed, "v_y": 0.1 * yaw_rate, "yaw_rate": yaw_rate,
        "steering": steering, "steering_rate": np.gradient(steering, t), "throttle": np.sin(w * t / 7.0),
        "alpha_f": 0.2 * steering, "alpha_r": -0.05 * yaw_rate,
    }  # fmt: skip


def tracks_of(miss_before: float, miss_after: float) -> dict[str, Floats]:
    drive = _drive(1.0 / 30.0)
    keep = (drive["time_s"] % 40.0) < 36.0  # a hole between blocks
    t, x, y = (drive[n][keep] for n in ("time_s", "x", "y"))
    new = np.r_[True, (np.diff(np.floor(t / 2.0)) > 0) | (np.diff(t) > 0.1)]
    ago = t - t[np.maximum.accumulate(np.where(new, np.arange(len(t)), 0))]
    grown = ago**2 * (1.0 + 0.8 * np.sin(t / 30.0))
    tracks = {"time_s": t, "x": x, "y": y, "start": new.astype(float)}
    for stage, miss in (("before", miss_before), ("after", miss_after)):
        tracks |= {f"{stage}_x": x + miss * grown * np.cos(t / 7.0), f"{stage}_y": y + miss * grown * np.sin(t / 7.0)}
    return tracks


def horizon(seconds: float, before: float, after: float, floor: float) -> dict[str, Any]:
    return {
        "horizon_s": seconds, "nmse_before": before, "before_ci95": [0.8 * before, 1.3 * before], "nmse_after": after,
        "after_ci95": [0.85 * after, 1.2 * after], "nmse_floor": floor, "ratio": after / before,
        "ratio_ci95": [0.75 * after / before, min(1.0, 1.3 * after / before)],
    }  # fmt: skip


def common(verdict: str, before: float, after: float) -> dict[str, Any]:
    floor, worse = 0.0019, 1.0 if after == before else 1.3
    return {
        "schema": "bcid.diagnosis/1", "verdict": verdict, "vehicle": "bumper-car", "recordings": ["arena_03.mcap"],
        "duration_s": DURATION_S, "simulation": "newton-euler, refitted on this recording",
        "mismatch": {"detected": verdict != "nothing-found", "p_value": 0.43 if verdict == "nothing-found" else 0.0004,
                     "where": {"channel": None, "depends_on": [], "regime": "throughout", "time_s": [[0.0, DURATION_S]],
                               "place": None}},
        "findings": [], "unknown": None,
        "fit": {"horizon_s": 2.0, "nmse_before": before, "nmse_after": after, "nmse_floor": floor,
                "ratio_ci95": [0.75 * after / before, min(1.0, 1.3 * after / before)]},
        "not_excited": [
            {"effect": e, "smallest_detectable": {"value": v, "unit": u}}
            for e, v, u in [("tether_pull", 4.0, "N/m"), ("motor_sag", 0.5, "1"), ("clock_drift", 8.3e-5, "1")]
        ],
        "next_manoeuvre": None,
        "contacts": [{"begin_s": 41.2, "end_s": 41.5, "x_m": 5.1, "y_m": -2.0, "kind": "contact"},
                     {"begin_s": 199.0, "end_s": 203.0, "x_m": -4.6, "y_m": 1.7, "kind": "crash"}],
        "corrections": [],
        "base": {"parameters": [{"symbol": s, "value": v, "se": e, "unit": u} for s, v, e, u in [
            ("I_z", 90.85, 1.3, "kg m^2"), ("C_f", 3594.0, 118.0, "kg m s^-2 rad^-1"), ("K_t", 274.8, 3.1, "kg s^-1"),
        ]]},
        "rivals": [], "placebos": [{"name": f"placebo {i}", "gain_nats": 0.3 * i - 0.4} for i in range(3)],
        "horizons": [horizon(0.5, before / 8, worse * after / 8, floor / 8), horizon(2.0, before, after, floor),
                     horizon(10.0, 9 * before, 9 * after, 8.1 * floor)],
    }  # fmt: skip


def finding(effect: str, values: dict[str, tuple[float, float, str]], twins: tuple[str, ...] = (), **more: Any) -> Any:
    entry = EFFECTS[effect]
    return {
        "effect": effect, "kind": entry.kind, "twins": list(twins), "probability": 0.55 if twins else 0.998,
        "equation": entry.equation, "heldout_gain": 162.0, "gain_nats": 171.0,
        "parameters": {s: {"value": v, "se": e, "unit": u} for s, (v, e, u) in values.items()},
        "sentence": "The wheels roll harder over one part of the floor.",
    } | more  # fmt: skip


def named() -> Made:
    d = common("named", 0.0058, 0.0020)
    values = {"b": (27.6, 1.9, "kg s^-1"), "x": (2.06, 0.07, "m"), "y": (1.04, 0.06, "m"), "radius": (1.12, 0.05, "m")}
    d["mismatch"]["where"] |= {
        "channel": "fx", "depends_on": ["place", "v_x"], "regime": "fast, above 1.2 m/s",
        "place": {"x_m": 2.06, "y_m": 1.04, "radius_m": 1.12},
    }  # fmt: skip
    d["findings"] = [finding("rough_patch", values)]
    d["rivals"] = [
        {"effects": ["rear_rolling_viscous"], "behind_nats": 96.0, "why_not": "leaves the place: p < 0.001 there"},
        {"effects": ["slippery_patch", "yaw_scrub"], "behind_nats": 141.3, "why_not": "acts on the wrong channel"},
    ]
    k = _drive(0.5)
    inside = np.hypot(k["x"] - 2.06, k["y"] - 1.04) < 1.12
    return d, knots_of({"fx": -0.09 * k["v_x"] * inside}), tracks_of(0.05, 0.008)


def ambiguous() -> Made:
    d = common("ambiguous", 0.0047, 0.0021)
    d["mismatch"]["where"] |= {"channel": "fx", "depends_on": ["v_x"]}
    d["findings"] = [
        finding("rear_rolling_viscous", {"b": (16.9, 1.1, "kg s^-1")}, ("quadratic_drag", "yaw_scrub"), sentence="")
    ]
    d["rivals"] = [{"effects": ["quadratic_drag"], "behind_nats": 1.2, "why_not": "not ruled out"}]
    d["next_manoeuvre"] = {
        "name": "coast-down", "separates": ["rear_rolling_viscous", "quadratic_drag"], "score": 31.0,
        "why": "Slowing down from full speed tells a drag that grows with speed from one that grows with its square.",
        "file": "next.commands.csv",
    }  # fmt: skip
    d["schema"] = "bcid.diagnosis/2"
    d["remainder"] = [
        {"channel": "fx", "nats_before": 140.0, "nats_left": 0.4, "curve": law(0.06)},
        {"channel": "pose", "nats_before": 2.0, "nats_left": 0.0, "curve": None},
    ]
    k = _drive(0.5)
    return d, knots_of({"fx": 0.12 - 0.06 * k["v_x"]}), tracks_of(0.04, 0.01)


def law(size: float, named: bool = True, **more: Any) -> dict[str, Any]:
    """A drag of so many m/s^2 at 1 m/s, as free functions show it."""
    x = np.linspace(0.1, 1.5, 15)
    curve = {
        "quantity": "v_x", "unit": "m/s", "y_unit": "m/s^2", "x": x.tolist(), "y": (-size * x).tolist(),
        "sd": np.full(15, 0.008).tolist(), "named": (-size * x + 0.004).tolist() if named else None,
    }  # fmt: skip
    return curve | more


def unknown() -> Made:
    d = common("unknown", 0.0049, 0.0046)
    d["mismatch"]["where"] |= {"channel": "mz", "depends_on": ["steering_rate"], "regime": "steering moving"}
    d["unknown"] = {
        "channel": "mz", "depends_on": ["steering_rate"], "form": "M_z += −14.2 N m/(rad/s)·δ̇", "heldout_gain": 80.3,
    }  # fmt: skip
    d["corrections"] = [
        {"correction": "tyre_fall", "equation": "tyres' grip falls towards (1 − f)·F̂ past saturation",
         "parameters": {"f": {"value": 0.21, "se": 0.04, "unit": "1"}}},
    ]  # fmt: skip
    d["not_excited"] = [{"effect": e, "smallest_detectable": None} for e in list(EFFECTS)[:12]]
    k = _drive(0.5)
    return d, knots_of({"mz": -0.16 * k["steering_rate"]}, vanishes=False), tracks_of(0.04, 0.038)


def nothing() -> Made:
    d = common("nothing-found", 0.00193, 0.00193)
    d["mismatch"]["where"] = None
    d["contacts"] = []
    return d, knots_of(), tracks_of(0.01, 0.01)


@pytest.fixture
def undrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pictures are composed but not rendered, which takes most of the time."""
    for module in (before_after_figures, law_figures, where_figures):
        monkeypatch.setattr(module, "render_svg", lambda figure, label: SVG)


VERDICTS = {"named": named, "ambiguous": ambiguous, "unknown": unknown, "nothing-found": nothing}


class Tags(HTMLParser):
    """The elements and attributes that a browser would see."""

    def __init__(self) -> None:
        super().__init__()
        self.seen: list[tuple[str, dict[str, str | None]]] = []
        self.open: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.seen.append((tag, dict(attrs)))
        if tag not in ("meta", "br"):
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


def page(made: Made, folder: Path) -> tuple[str, Tags]:
    write_diagnosis_page(*made, folder / "diagnosis.html")
    text = (folder / "diagnosis.html").read_text(encoding="utf-8")
    tags = Tags()
    tags.feed(text)
    assert tags.open == []
    return text, tags


def inert(tags: Tags) -> None:
    assert {t for t, _ in tags.seen}.isdisjoint({"script", "link", "iframe", "object", "embed", "base", "form", "a"})
    for _, attributes in tags.seen:
        assert not any(name.startswith("on") for name in attributes)
        assert not {"src", "href", "action", "data"} & set(attributes)
        # marks of a picture that are drawn again, and pixels within it
        assert str(attributes.get("xlink:href", "#")).startswith(("#", "data:image/png;base64,"))


@pytest.mark.parametrize("verdict", VERDICTS)
def test_every_verdict_has_a_page_that_needs_nothing_from_outside(verdict: str, tmp_path: Path) -> None:
    text, tags = page(VERDICTS[verdict](), tmp_path)
    inert(tags)
    assert "default-src 'none'" in text
    assert "http:" not in text
    assert "https:" not in text
    assert f'class="verdict {verdict}"' in text
    assert sum(tag == "svg" for tag, _ in tags.seen) >= 5
    assert not re.search(r"\b(nan|None|inf)\b", re.sub(r'xlink:href="[^"]*"', "", text))
    assert len(text) < 1_000_000


def test_named_says_what_how_large_and_what_it_helps() -> None:
    said = verdict_sentence(named()[0])
    assert said.startswith("Missing in the model: rough patch (environment), b = 27.6 ± 1.9 N s/m, x = 2.06")
    assert "radius = 1.12 ± 0.05 m" in said
    assert "the held-out 2 s error (NMSE) falls by 66 % (95 % interval 55 to 74 %)" in said
    assert "1.05 times the noise floor" in said


def test_a_simulation_is_said_only_of_what_somebody_gave() -> None:
    d = named()[0]
    assert "simulation" not in verdict_sentence(d)
    assert verdict_sentence(d | {"simulation": "published.toml"}).startswith("Missing in the simulation: rough patch")
    assert DiagnosisDocument.model_validate(d).compared_with == "model"


def test_the_page_says_from_where_the_next_drive_sets_off(tmp_path: Path) -> None:
    d, knots, tracks = ambiguous()
    d["next_manoeuvre"] |= {
        "start": {"x_m": -1.75, "y_m": 1.84, "yaw_rad": np.pi / 2}, "seconds": 29.6,
        "floor": {"x_m": [-4.0, 5.2], "y_m": [-3.1, 2.9]},
    }  # fmt: skip
    said = (
        "Set the car down at rest at x = −1.75 m, y = 1.84 m, heading 90°, its wheel straight; the drive takes 30 s, "
        "and keeps to x = −4.0 to 5.2 m and y = −3.1 to 2.9 m"
    )
    text, _ = page((d, knots, tracks), tmp_path)
    assert text.count(said) == 2  # in short, and beside the file of commands
    told = io.StringIO()
    Console(file=told, width=10_000).print(diagnosis_tables(DiagnosisDocument.model_validate(d)))
    assert said in told.getvalue()


def test_the_python_of_the_page_runs(tmp_path: Path) -> None:
    (tmp_path / "model").mkdir()
    save_model(MODELS["newton-euler-augmented"], tmp_path / "model")
    text = (files("bcid.report") / "use_model.py.j2").read_text(encoding="utf-8")
    assert text.strip() in html.unescape(page(named(), tmp_path)[0])
    done = subprocess.run([sys.executable, "-c", text], cwd=tmp_path, capture_output=True, text=True, check=True)
    assert "v_x" in done.stdout


def test_a_channel_that_others_stand_in_for_is_explained(tmp_path: Path) -> None:
    d, knots, tracks = unknown()
    without = "is not among them: alone it explains most"
    d["channels"] = {"mz": 40.0, "fx": 12.0}
    assert without not in page((d, knots, tracks), tmp_path)[0]
    d["channels"] = {"mz": 0.0, "fx": 12.0}
    assert f"The yaw moment (mz) {without}" in page((d, knots, tracks), tmp_path)[0]


def test_a_measurement_effect_is_never_said_of_the_vehicle() -> None:
    d = named()[0] | {"findings": [finding("pose_latency", {"tau": (0.0112, 0.0006, "s")})]}
    assert verdict_sentence(d).startswith("The recording is off, not the vehicle: pose latency, τ = 0.0112 ± 0.0006 s.")


def test_several_findings_and_a_remainder_are_all_said() -> None:
    d = named()[0]
    d["findings"].append(finding("pose_latency", {"tau": (0.0112, 0.0006, "s")}))
    d["unknown"] = unknown()[0]["unknown"]
    said = verdict_sentence(d)
    assert "rough patch (environment)" in said
    assert "; pose latency (measurement), τ" in said
    assert "With them the held-out" in said
    rest = "is left that no named effect explains: it acts on the yaw moment"
    assert f"Too small to show in predictions, something more {rest}" in said
    assert said.endswith("So each ± is too small.")
    d["fit"]["nmse_after"] = 2.0 * d["fit"]["nmse_floor"]
    assert f". Something more {rest}" in verdict_sentence(d)
    d["fit"]["nmse_floor"] = None
    assert f". Something more {rest}" in verdict_sentence(d)


def test_ambiguous_names_all_that_cannot_be_told_apart() -> None:
    said = verdict_sentence(ambiguous()[0])
    assert (
        "cannot tell which: rear rolling viscous, b = 16.9 ± 1.1 N s/m, or instead quadratic drag or yaw scrub." in said
    )
    assert "falls by 55 %" in said
    assert "Missing in the" not in said


def test_ambiguous_keeps_apart_what_stands_alone() -> None:
    d = ambiguous()[0]
    d["findings"].insert(0, finding("motor_dead_zone", {"width": (0.13, 0.01, "m/s")}))
    said = verdict_sentence(d)
    assert said.startswith("Missing in the model: motor dead zone, width = 0.130 ± 0.010 m/s. Something more is")


def test_unknown_says_channel_dependence_and_form() -> None:
    said = verdict_sentence(unknown()[0])
    assert said.startswith("Something is missing that no named effect explains: it acts on the yaw moment (mz)")
    assert "depends on steering rate" in said
    assert "−14.2 N m/(rad/s)·δ̇" in said
    assert "tyre fall" in verdict_sentence(unknown()[0] | {"unknown": None})


def test_unknown_without_a_form_says_how_much_free_functions_explain() -> None:
    d = unknown()[0]
    d["unknown"] |= {"channel": "fx", "depends_on": [], "form": None, "gain_nats": 73.4}
    said = verdict_sentence(d)
    assert "it acts on the forward force (fx); over all channels free functions gain 73 nats" in said, said
    d["unknown"] |= {"channel": None, "gain_nats": None}
    assert verdict_sentence(d).endswith("its channel is not clear.")


@pytest.mark.usefixtures("undrawn")
def test_the_page_shows_what_is_known_of_what_has_no_name_and_no_more(tmp_path: Path) -> None:
    d, knots, tracks = unknown()
    d["unknown"] |= {"form": None, "heldout_gain": None, "gain_nats": 73.4}
    shown, _ = page((d, knots, tracks), tmp_path)
    assert "73.4 nats likelier" in shown
    assert "Still predictable" not in shown
    assert "<dt>Form</dt>" not in shown
    assert "<dt>Form</dt>" in page(unknown(), tmp_path)[0]


def test_nothing_found_says_so() -> None:
    said = verdict_sentence(nothing()[0])
    assert said.startswith("Nothing is missing beyond the noise floor: 2 s ahead")
    assert "1.02 times" in said
    assert "(p = 0.43)" in said
    seen = nothing()[0] | {"mismatch": {"detected": True, "p_value": 0.004, "where": None}}
    assert "p = 0.004" in verdict_sentence(seen)


def test_an_error_that_grows_is_not_said_to_fall() -> None:
    d = named()[0]
    d["fit"] |= {"nmse_after": 0.0087, "ratio_ci95": [1.2, 1.8]}
    assert "rises by 50 % (95 % interval 20 to 80 %)" in verdict_sentence(d)
    assert "rests not on this error but on the likelihood" in verdict_sentence(d)


def test_an_error_that_stays_is_not_said_to_change_and_the_evidence_is_named() -> None:
    d = named()[0]
    d["findings"][0]["heldout_gain"] = 1971.0
    d["fit"] |= {"nmse_after": 0.00581, "ratio_ci95": [0.99, 1.02]}
    said = verdict_sentence(d)
    assert "hardly changes (0 %, 95 % interval −1 % to +2 %), and stays at 3.06 times the noise floor." in said
    assert "rough patch makes those held out 1971 nats likelier" in said
    d["findings"][0]["heldout_gain"] = -3.0
    assert "take it with care" in verdict_sentence(d)
    assert "rests not on" not in verdict_sentence(named()[0])


def test_what_keeps_an_error_above_the_floor_is_said() -> None:
    d = named()[0]
    assert "floor" not in verdict_sentence(d).partition("the noise floor.")[2]
    d["fit"]["nmse_after"] = 0.0045
    assert "bumps" in verdict_sentence(d)
    d["remainder"] = [{"channel": c, "nats_left": n} for c, n in (("fy", 2.0), ("mz", 7.4))]
    assert verdict_sentence(d).endswith("most of what free functions still see acts on the yaw moment (mz) (7.4 nats).")
    d["unknown"] = {"channel": "mz", "gain_nats": 40.0}  # is said already
    assert "What keeps it" not in verdict_sentence(d)
    d = nothing()[0]
    d["fit"]["nmse_before"] = 0.0057
    said = verdict_sentence(d)
    assert said.startswith("Nothing is found that is missing, and no place or time stands out (p = 0.43), and yet 2 s")
    assert "3.00 times what noise and random disturbances leave. Neither an effect" in said


@pytest.mark.usefixtures("undrawn")
@pytest.mark.parametrize("verdict", VERDICTS)
def test_empty_lists_and_nulls_do_not_break_it(verdict: str, tmp_path: Path) -> None:
    d, knots, tracks = VERDICTS[verdict]()
    for key in ("contacts", "corrections", "rivals", "placebos", "horizons", "not_excited", "recordings"):
        d[key] = []
    whole = d
    few = {"schema": d["schema"], "verdict": verdict, "findings": [{"effect": f["effect"]} for f in d["findings"]]}
    knots, tracks = {n: v[:3] for n, v in knots.items()}, {n: v[:0] for n, v in tracks.items()}
    for document in (whole, few, dict.fromkeys(d) | few):
        text, _ = page((document, knots, tracks), tmp_path)
        assert verdict_sentence(document).split(":")[0].split(".")[0] in text
        assert not re.search(r"\bNone\b|\bnan\b|Undefined", text)


@pytest.mark.usefixtures("undrawn")
def test_what_chance_reaches_is_told(tmp_path: Path) -> None:
    d, knots, tracks = named()
    text, _ = page((d | {"gate_nats": 12.4}, knots, tracks), tmp_path)
    assert "Chance alone hardly reaches 12.4 nats" in text
    findings = [f | {"gate_nats": 11.5} for f in d["findings"]]
    own = page((d | {"gate_nats": 12.4, "findings": findings}, knots, tracks), tmp_path)[0]
    assert re.search(r"what chance hardly reaches with that effect: [\w ]+ 11.5 nats", own)
    same = [f | {"gate_nats": 12.4} for f in d["findings"]]
    assert "A name must add as much." in page((d | {"gate_nats": 12.4, "findings": same}, knots, tracks), tmp_path)[0]
    assert "Chance alone" not in page((d | {"gate_nats": None}, knots, tracks), tmp_path)[0]


@pytest.mark.usefixtures("undrawn")
def test_null_figures_are_dashes(tmp_path: Path) -> None:
    d, knots, tracks = named()
    d["horizons"] = [dict.fromkeys(h) | {"horizon_s": h["horizon_s"]} for h in d["horizons"]]
    d["fit"] = dict.fromkeys(d["fit"]) | {"horizon_s": 2.0}
    d["findings"][0]["parameters"] = {"b": {"value": None, "se": None, "unit": "kg s^-1"}}
    d["base"]["parameters"][0] |= {"value": None, "se": None}
    knots["after_fx"][5] = np.nan
    text, _ = page((d, knots, tracks), tmp_path)
    assert "b = –" in text


@pytest.mark.usefixtures("undrawn")
def test_a_parameter_that_could_go_no_farther_is_told(tmp_path: Path) -> None:
    d, knots, tracks = named()
    assert "at its bound" not in page((d, knots, tracks), tmp_path)[0]
    d["base"]["parameters"][2]["at_bound"] = True
    (row,) = [r for r in page((d, knots, tracks), tmp_path)[0].split("<tr>") if "at its bound" in r]
    assert row.startswith("<td>K_t</td>")


@pytest.mark.usefixtures("undrawn")
def test_hostile_names_are_inert(tmp_path: Path) -> None:
    def poisoned(value: Any) -> Any:
        if isinstance(value, str):
            return HOSTILE
        if isinstance(value, list):
            return [poisoned(v) for v in value]
        return {k: poisoned(v) for k, v in value.items()} if isinstance(value, dict) else value

    for verdict, made in VERDICTS.items():
        d, knots, tracks = made()
        d = poisoned(d) | {"schema": d["schema"], "verdict": verdict}
        text, tags = page((d, knots, tracks), tmp_path)
        inert(tags)
        assert "&lt;script&gt;" in text
        assert "{{ 7 * 7 }}" in text


@pytest.mark.usefixtures("undrawn")
def test_pictures_show_the_component_of_the_channel() -> None:
    d, knots, _ = named()
    assert "forward acceleration" in where_pictures(d, knots)[0].caption.lower()
    d["mismatch"]["where"]["channel"] = "steering"  # shows where most vanishes
    assert "forward acceleration" in where_pictures(d, knots)[0].caption.lower()
    d, knots, _ = unknown()
    assert "yaw acceleration" in where_pictures(d, knots)[0].caption.lower()
    assert "steering rate" in where_pictures(d, knots)[0].title


@pytest.mark.usefixtures("undrawn")
def test_the_missing_law_is_shown_before_any_hypothesis(tmp_path: Path) -> None:
    d, knots, tracks = ambiguous()
    (picture,) = law_pictures(d)
    assert picture.title == "The missing law, before any hypothesis"
    assert "from −0.0060 m/s² at 0.10 m/s to −0.090 m/s² at 1.5 m/s" in picture.caption
    assert "if rear rolling viscous were all that is missing, within the band throughout" in picture.caption
    text, _ = page((d, knots, tracks), tmp_path)
    assert 0 < text.index(picture.title) < text.index("Over time")
    (curve,) = [r["curve"] for r in d["remainder"] if r["curve"]]
    curve["named"][:3] = [0.1, 0.1, 0.1]
    assert "within the band at 12 of 15 points" in law_pictures(d)[0].caption
    curve["named"] = None
    assert law_pictures(d)[0].caption.endswith("No effect is named.")


@pytest.mark.usefixtures("undrawn")
def test_what_tells_nothing_is_not_drawn_as_a_law() -> None:
    """Nor what is no curve, nor more than a reader compares."""
    d = ambiguous()[0]
    part = d["remainder"][0]
    for curve in (None, law(0.001), law(0.06, quantity="phase of the moon"), law(0.06, named=False, x=[], y=[], sd=[])):
        assert law_pictures(d | {"remainder": [part | {"curve": curve}]}) == []
    assert law_pictures(d | {"remainder": [part | {"channel": "pose"}]}) == []
    many = law_pictures(d | {"remainder": [part | {"channel": c} for c in ("mz", "fx", "fy", "steering")]})
    assert [p.title.rpartition(": ")[2] for p in many] == [many[0].title, "forward acceleration"]
    assert law_pictures(named()[0]) == []


def test_a_law_that_swings_in_time_is_drawn_within_its_period() -> None:
    d = ambiguous()[0]
    wave = law(0.06, named=False, quantity="time", period_s=2.69, direction="world_x")
    (picture,) = law_pictures(d | {"remainder": [{"channel": "fx", "nats_before": 90.0, "curve": wave}]})
    assert "acceleration along the floor’s x that swings in time by ± 0.042 m/s²" in picture.caption
    assert "period of 2.69 s" in picture.caption
    assert all(panel.startswith("<svg ") for panel in picture.panels)


@pytest.mark.usefixtures("undrawn")
def test_residuals_are_shown_where_the_mismatch_was_located() -> None:
    d, knots, tracks = named()
    assert "within the circle located" in proof_pictures(d, knots, tracks)[-1].caption
    d["mismatch"]["where"] |= {"place": None, "time_s": [[100.0, 130.0]]}
    assert "in the time located" in proof_pictures(d, knots, tracks)[-1].caption
    assert where_pictures(d, knots)[0].title == "Over time"
    d, knots, tracks = ambiguous()
    assert "where the forward speed is below" in proof_pictures(d, knots, tracks)[-1].caption
    d, knots, tracks = nothing()
    assert "located" not in proof_pictures(d, knots, tracks)[-1].title


@pytest.mark.usefixtures("undrawn")
def test_paths_are_those_of_the_worst_stretch() -> None:
    d, knots, tracks = named()
    late = (tracks["time_s"] > 200.5) & (tracks["time_s"] < 212.0)
    tracks["before_x"] = tracks["x"] + 0.9 * late
    begin = re.search(r"The 20 s from (\d+) s on", proof_pictures(d, knots, tracks)[1].caption)
    assert begin is not None
    assert 190 <= int(begin[1]) <= 201


def test_pictures_can_stand_alone() -> None:
    d, knots, _ = named()
    pictures = where_pictures(d, knots)
    assert len(pictures) == 3
    for picture in pictures:
        for panel in picture.panels:
            assert panel.startswith('<svg viewBox="0 0 360 ')
            assert len(panel) > 5_000


def test_a_sparse_drive_over_a_wide_floor_can_be_drawn() -> None:
    d, knots, _ = nothing()
    sparse = {n: v[::10] for n, v in knots.items()}
    sparse |= {"x": 40.0 * sparse["x"], "y": 40.0 * sparse["y"]}
    for columns in (sparse, knots | {"x": 0.0 * knots["x"], "y": 0.0 * knots["y"]}):
        assert [p.panels[0].startswith("<svg ") for p in where_pictures(d, columns)] == [True] * 3


def test_throttle_and_brake_are_told_apart() -> None:
    knots = {"throttle": np.array([-0.5, 1.0])}
    np.testing.assert_array_equal(knot_variable("throttle", knots), [0.0, 1.0])
    np.testing.assert_array_equal(knot_variable("braking", knots), [0.5, 0.0])


@pytest.mark.parametrize(
    ("value", "se", "shown"),
    [
        (0.0, 0.3, "0.0 ± 0.3"),
        (27.6, 1.9, "27.6 ± 1.9"),
        (27.6, 1.97, "28 ± 2"),
        (1.0, 0.096, "1.00 ± 0.10"),
        (-0.0123, 0.00031, "−0.0123 ± 0.0003"),
        (3.5e-5, None, "3.50 × 10⁻⁵"),
        (2.5, 0.0, "2.50"),
        (999.6, 14.0, "1000 ± 14"),
    ],
)
def test_values_are_rounded_by_their_error(value: float, se: float | None, shown: str) -> None:
    assert format_with_error(value, se) == shown


def test_numbers_keep_their_digits() -> None:
    assert [format_number(v) for v in (0.0, 9.996, 0.5, 123456.0)] == ["0.00", "10.0", "0.500", "1.23 × 10⁵"]


def test_a_quantity_that_never_changes_is_not_drawn() -> None:
    """Nor the end of a report: without braking, and with nothing to explain, there may be one quantity only."""
    d, knots = named()[0], dict(knots_of())
    d["mismatch"]["where"] = None
    for name in ("v_x", "v_y", "yaw_rate", "steering", "steering_rate", "alpha_f", "alpha_r", "heading", "throttle"):
        knots[name] = np.full_like(knots[name], 1.0)
    assert two_variables(d, knots, residual_of(d, knots))
    knots["v_x"] = np.linspace(0.5, 1.5, len(knots["v_x"]))
    assert "braking" not in two_variables(d, knots, residual_of(d, knots))
