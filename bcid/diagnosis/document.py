"""diagnosis.json (contract `bcid.diagnosis/1`) and the columns that the page draws from."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from bcid.aliases import Floats
from bcid.diagnosis.diagnose import Diagnosis
from bcid.diagnosis.judge.prediction_error import Horizon, Tracks
from bcid.diagnosis.judge.verdict import Finding, alike
from bcid.diagnosis.locate.location import SIGNIFICANT
from bcid.diagnosis.locate.pushes import CHANNELS
from bcid.diagnosis.search.refits import corrections, named
from bcid.effects.corrections import CORRECTIONS
from bcid.effects.entry import Effect, Parameter
from bcid.effects.table import EFFECTS, ENTRIES, effects_of
from bcid.likelihood.hypothesis import DRAG
from bcid.models.newton_euler.augmented import FORCE_UNITS, UNITS

SCHEMA = "bcid.diagnosis/1"
PLACEBOS = 3
HARDLY = 0.2  # relative standard error from which a base parameter is not quoted as known
THROTTLE = "m/s; 1 where it sets a force"
KNOT_UNITS = {
    "time_s": "s", "segment": "1", "x": "m", "y": "m", "heading": "rad", "v_x": "m/s", "v_y": "m/s",
    "yaw_rate": "rad/s", "steering": "rad", "steering_rate": "rad/s", "throttle": THROTTLE, "alpha_f": "rad",
    "alpha_r": "rad", "before_fx": "m/s^2", "before_fy": "m/s^2", "before_mz": "rad/s^2", "after_fx": "m/s^2",
    "after_fy": "m/s^2", "after_mz": "rad/s^2",
}  # fmt: skip
TRACK_UNITS = {
    "time_s": "s", "x": "m", "y": "m", "before_x": "m", "before_y": "m", "after_x": "m", "after_y": "m", "start": "1"
}  # fmt: skip


def as_json(found: Diagnosis, horizons: Sequence[Horizon], about: dict[str, Any]) -> dict[str, Any]:
    """The whole of it; `about` holds vehicle, recordings, duration_s and simulation."""
    judgement = found.judgement
    detected = bool(judgement.findings) or judgement.verdict == "unknown" or found.p_value < SIGNIFICANT
    hypothesis = judgement.fit.hypothesis
    corrected = corrections(judgement.fit)
    unknown = judgement.verdict == "unknown" or judgement.more_is_left
    return {
        "schema": SCHEMA,
        **about,
        "verdict": judgement.verdict,
        "mismatch": {"detected": detected, "p_value": found.p_value, "where": _where(found) if detected else None},
        "channels": {channel: round(nats, 1) for channel, nats in found.location.left.entering.items()},
        "findings": [_finding(f, hypothesis.entries[f.effect]) for f in judgement.findings],
        "unknown": _unknown(found, corrected) if unknown else None,
        "fit": _fit(horizons),
        "horizons": [_horizon(h) for h in horizons],
        "not_excited": [
            {"effect": u.effect, "parameter": u.symbol, "smallest_detectable": {"value": u.smallest, "unit": u.unit}}
            for u in found.unexcited
        ],
        "next_manoeuvre": None,
        "contacts": [
            {"begin_s": c.begin_s, "end_s": c.end_s, "x_m": c.x_m, "y_m": c.y_m, "kind": c.kind} for c in found.contacts
        ],
        "corrections": [_correction(found, n) for n in corrected],
        "base": {"parameters": _base(found)},
        "rivals": _rivals(found),
        "placebos": [
            {"name": f"{c.effect}, carried half a take away", "gain_nats": c.score}
            for c in found.search.nulls.placebos[:PLACEBOS]
        ],
        "dropped": list(judgement.dropped),
    }


def _where(found: Diagnosis) -> dict[str, Any]:
    """Where the mismatch is; what was named says it best: the first its channel, the first local one its place."""
    location, findings = found.location, found.judgement.findings
    channel, depends = location.channel, list(location.depends_on)
    place = location.place if "place" in depends else None
    T = found.take.T
    times = [[0.0, T]]
    if findings:
        effect = EFFECTS[findings[0].effect]
        depends = list(effect.depends_on)
        channel = location.channel if effect.channel == "any" else effect.channel  # a change of mass acts on all
        values = [{s: v for s, (v, _) in f.values.items()} for f in findings]
        circles = [(v["x"], v["y"], v["radius"]) for v in values if "radius" in v]
        end = float(found.take.length_s.max())  # a time counts from where its recording begins
        times = [[v["t_s"], end] for v in values if "t_s" in v] or times
        return _located(channel, depends, location.regime, times, circles[0] if circles else None)
    if location.window is not None and "time" in depends:
        times = [[location.window.begin_s, location.window.end_s]]
    return _located(channel, depends, location.regime, times, (place.x, place.y, place.radius) if place else None)


def _located(
    channel: str, depends: list[str], regime: str, times: list[list[float]], place: tuple[float, float, float] | None
) -> dict[str, Any]:
    circle = dict(zip(("x_m", "y_m", "radius_m"), place, strict=True)) if place else None
    return {"channel": channel, "depends_on": depends, "regime": regime, "time_s": times, "place": circle}


def _numbers(parameters: Sequence[Parameter], values: dict[str, tuple[float, float]]) -> dict[str, Any]:
    quoted = [(p.quoted(*values[p.symbol]), p.at_bound(values[p.symbol][0])) for p in parameters if p.symbol in values]
    return {q.symbol: {"value": q.value, "se": q.se, "unit": q.unit, "at_bound": stuck} for q, stuck in quoted}


def _finding(f: Finding, effect: Effect) -> dict[str, Any]:
    return {
        "effect": f.effect,
        "kind": effect.kind,
        "twins": list(f.twins),
        "probability": f.probability,
        "equation": effect.equation,
        "parameters": _numbers(effect.parameters, f.values),
        "heldout_gain": f.heldout.nats,
        "heldout_gain_ci95": list(f.heldout.ci95),
        "gain_nats": f.gain,
        "sentence": _sentence(f, effect),
        "held": effect.held or None,
    }


def _sentence(f: Finding, effect: Effect) -> str:
    told = [(p.meaning, p.quoted(*f.values[p.symbol])) for p in effect.parameters if p.symbol in f.values]
    words = ", ".join(f"{m} {q.symbol} = {q.value:.3g} ± {q.se:.1g} {q.unit}".removesuffix(" –") for m, q in told)
    return f"{f.effect.replace('_', ' ')}: {words}"


def _correction(found: Diagnosis, name: str) -> dict[str, Any]:
    values, entry = found.judgement.fit.values(), CORRECTIONS[name]
    by_symbol = {p.symbol: values[f] for f, p in zip(entry.fields, entry.parameters, strict=True)}
    return {"correction": name, "equation": entry.equation, "parameters": _numbers(entry.parameters, by_symbol)}


def _unknown(found: Diagnosis, corrected: Sequence[str]) -> dict[str, Any]:
    judgement = found.judgement
    left, way = judgement.left.remainder, judgement.left.way(judgement.gate)
    if judgement.nats_left > 0.0:
        return {
            "channel": judgement.left.channel, "depends_on": list(left.depends_on) if left.predictable else [],
            "form": left.form if left.channel == judgement.left.channel else None,
            "heldout_gain": left.gain, "gain_nats": judgement.nats_left, "lies": way.words if way else None,
        }  # fmt: skip
    words = "; ".join(ENTRIES[n].equation for n in corrected)
    depends = list(dict.fromkeys(d for n in corrected for d in ENTRIES[n].depends_on))
    gained = judgement.corrections
    return {
        "channel": found.location.channel, "depends_on": depends, "form": words or None,
        "heldout_gain": gained.nats if gained else 0.0,
    }  # fmt: skip


def _fit(horizons: Sequence[Horizon]) -> dict[str, Any] | None:
    two = next((h for h in horizons if h.horizon_s == 2.0), None)
    return None if two is None else {
        "horizon_s": 2.0, "nmse_before": two.before, "nmse_after": two.after, "nmse_floor": two.floor,
        "ratio_ci95": _ends(two.ratio_ci95),
    }  # fmt: skip


def _horizon(h: Horizon) -> dict[str, Any]:
    ratio = h.after / h.before if h.before and h.after is not None else None
    return {
        "horizon_s": h.horizon_s, "lost": h.lost, "nmse_given": h.given, "given_lost": h.given_lost,
        "nmse_before": h.before, "before_ci95": _ends(h.before_ci95), "nmse_after": h.after,
        "after_ci95": _ends(h.after_ci95), "nmse_floor": h.floor, "ratio": ratio, "ratio_ci95": _ends(h.ratio_ci95),
    }  # fmt: skip


def _ends(interval: tuple[float, float] | None) -> list[float] | None:
    return None if interval is None else list(interval)


def _base(found: Diagnosis) -> list[dict[str, Any]]:
    """The refitted parameters of the base model and of what its simulation has.

    `shown` is false where the recording hardly says anything of one; one `at_bound` is as far from where it started as
    a car may be, or as a simulation's is trusted.
    """
    fit = found.judgement.fit
    car, hypothesis, values = fit.car(), fit.hypothesis, fit.values()
    se = np.sqrt(np.maximum(np.diag(fit.covariance), 0.0))
    units = FORCE_UNITS if car.sets_force else UNITS
    scales = [*(getattr(car, s) for s in hypothesis.logs), *hypothesis.drag_units]
    stuck = hypothesis.at_bound(fit.phi).tolist()
    rows = [
        {
            "symbol": s, "value": getattr(car, s), "se": float(abs(scale) * e), "unit": units[s],
            "shown": bool(e < HARDLY or s in DRAG), "at_bound": at_end,
        }
        for s, scale, e, at_end in zip((*hypothesis.logs, *DRAG), scales, se, stuck, strict=False)
    ]  # fmt: skip
    return rows + [
        {
            "symbol": field.replace("__", "."), "value": values[field][0], "se": values[field][1], "unit": p.unit,
            "shown": True, "at_bound": at_end,
        }
        for (field, p), at_end in zip(hypothesis.parameters, stuck[hypothesis.base_size :], strict=True)
        if effects_of([field])[0] in hypothesis.assumed
    ]  # fmt: skip


def _rivals(found: Diagnosis) -> list[dict[str, Any]]:
    search = found.judgement.search
    best, rows = search.best, []
    for other in search.others[:4]:
        behind = best.bic - other.bic
        why = (
            "cannot be told apart on this recording"
            if alike(best, other, found.take)
            else f"explains {behind:.0f} nats less"
        )
        rows.append({"effects": list(named(other)), "behind_nats": behind, "why_not": why})
    return rows


def knot_columns(found: Diagnosis) -> Floats:
    """The disturbances before and after, (K, len(KNOT_UNITS))."""
    b, m = found.before, found.before.mean
    columns = [
        b.time_s, b.segment, m["p_x"], m["p_y"], m["theta"], m["v_x"], m["v_y"], m["omega"], m["delta"],
        m["delta_rate"], m["u_m"], m["alpha_f"], m["alpha_r"], *b.push.T, *found.after.push.T,
    ]  # fmt: skip
    assert len(CHANNELS) == b.push.shape[1]  # noqa: S101
    return np.column_stack(columns)


def track_columns(tracks: Tracks) -> Floats:
    """Measured and predicted places, (K, len(TRACK_UNITS)); what diverged is the measured place."""
    filled = [np.where(np.isfinite(p), p, tracks.place) for p in (tracks.before, tracks.after)]
    return np.column_stack([tracks.time_s, tracks.place, *filled, tracks.start])
