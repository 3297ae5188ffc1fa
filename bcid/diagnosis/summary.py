"""A diagnosis as its document (`bcid.documents.diagnosis`), and the columns that its page draws from."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from bcid.aliases import Floats
from bcid.diagnosis.base_parameters import describe_base_parameters
from bcid.diagnosis.diagnose import Diagnosis
from bcid.diagnosis.judge.prediction_error import PredictedTracks
from bcid.diagnosis.judge.verdict import Finding, are_indistinguishable
from bcid.diagnosis.limits import LOCATE_LIMITS, SUMMARY_LIMITS
from bcid.diagnosis.locate.pushes import WRENCH_CHANNELS
from bcid.diagnosis.search.refits import estimates_by_symbol, fitted_corrections, named_effects
from bcid.documents import diagnosis as written
from bcid.effects.entry import Effect, Parameter
from bcid.effects.table import EFFECTS, ENTRIES

SUMMARY_S = 2.0  # the horizon that stands for all in `fit`
LAW_DIGITS = 4
LAW_UNITS = {"fx": "m/s^2", "motor": "m/s^2", "fy": "m/s^2", "mz": "rad/s^2", "steering": "rad"}
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


def summarise_diagnosis(
    diagnosis: Diagnosis, horizons: Sequence[written.HorizonError] = (), **about: Any
) -> written.DiagnosisDocument:
    """Summarise a diagnosis as the document diagnosis.json.

    `horizons` are prediction errors on held-out blocks, empty where they were not computed; `about` holds fields of
    the document that describe its input: vehicle, recordings, duration_s, simulation.
    """
    judgement, location, naming, fit = diagnosis.judgement, diagnosis.location, diagnosis.naming, diagnosis.fit
    significant = diagnosis.p_value < LOCATE_LIMITS.significant_p_value
    detected = bool(judgement.findings) or judgement.verdict == "unknown" or significant
    place, window = location.place, location.window
    return written.DiagnosisDocument(
        **about,
        verdict=judgement.verdict,
        mismatch=written.Mismatch(
            detected=detected, p_value=diagnosis.p_value, where=_describe_location(diagnosis) if detected else None
        ),
        channels={channel: round(nats, 1) for channel, nats in location.channel_nats.items()},
        findings=tuple(
            _describe_finding(f, fit.hypothesis.entries[f.effect], naming.gate_of(f.effect))
            for f in judgement.findings
        ),
        other_figures=tuple(
            written.OtherFigure(
                symbol=f.symbol, published=f.published, gain_nats=round(f.nats, 1),
                needed=written.Quantity(value=f.needed, se=f.se, unit=f.unit),
            )
            for f in diagnosis.other_figures
        ),
        unknown=_describe_unknown(diagnosis) if judgement.verdict == "unknown" or naming.unknown_nats > 0.0 else None,
        fit=next((written.FitSummary(**h.as_json()) for h in horizons if h.horizon_s == SUMMARY_S), None),
        horizons=tuple(horizons),
        not_excited=diagnosis.not_excited,
        nat_sizes={
            name: {s: float(f"{size:.4g}") for s, size in sizes.items()}
            for name, sizes in diagnosis.excitation.nat_sizes.items()
        },
        contacts=tuple(written.ContactSeen(**c._asdict()) for c in diagnosis.contacts),
        corrections=tuple(
            written.Correction(
                correction=name, equation=ENTRIES[name].equation,
                parameters=_quote_parameters(ENTRIES[name].parameters, estimates_by_symbol(fit, name)),
            )
            for name in fitted_corrections(fit)
        ),
        base=written.BaseModel(parameters=tuple(describe_base_parameters(fit))),
        rivals=tuple(_describe_rivals(diagnosis)),
        placebos=tuple(
            written.Placebo(name=f"{c.effect}, carried half a take away", gain_nats=c.score)
            for c in naming.nulls.placebos[: SUMMARY_LIMITS.max_placebos]
        ),
        dropped=tuple(naming.dropped),
        others_nats={name: round(nats, 1) for name, nats in naming.others.items()},
        gate_nats=round(naming.nulls.gate, 1),
        stretches=diagnosis.take.segments,
        located=written.Located(
            channel=location.channel,
            place=(place.x, place.y, place.radius) if place else None,
            window_s=(window.begin_s, window.end_s) if window else None,
        ),
        unexplained=written.Unexplained(
            channel_nats={c: round(nats, 1) for c, nats in naming.rest.seen.channel_nats().items()},
            gain_nats=naming.unknown_nats,
        ),
        remainder=_describe_remainder(diagnosis),
    )  # fmt: skip


def _describe_remainder(diagnosis: Diagnosis) -> tuple[written.ChannelRemainder, ...]:
    """What free functions explain in each channel, before any hypothesis and beside the names; most first."""
    before, left = diagnosis.location.channel_nats, diagnosis.naming.rest.seen.channel_nats()
    return tuple(
        written.ChannelRemainder(
            channel=channel, nats_before=round(before.get(channel, 0.0), 1), nats_left=round(left.get(channel, 0.0), 1),
            curve=_describe_law(diagnosis, channel),
        )
        for channel in dict.fromkeys((*before, *left))
    )  # fmt: skip


def _describe_law(diagnosis: Diagnosis, channel: str) -> written.LawCurve | None:
    """The missing law in a channel as a curve, to LAW_DIGITS; None where there is none."""
    law = diagnosis.laws.get(channel)
    if law is None:
        return None
    unit = KNOT_UNITS.get(law.quantity, "s")
    if law.quantity == "throttle":
        unit = "1" if diagnosis.fit.car().sets_force > 0.0 else "m/s"

    def rounded(values: Floats) -> tuple[float, ...]:
        """The values to LAW_DIGITS significant digits."""
        return tuple(float(f"{v:.{LAW_DIGITS}g}") for v in values)

    return written.LawCurve(
        quantity=law.quantity, unit=unit, y_unit=LAW_UNITS[channel], x=rounded(law.x), y=rounded(law.y),
        sd=rounded(law.sd), named=None if law.named is None else rounded(law.named), period_s=law.period_s,
        direction=law.direction,
    )  # fmt: skip


def _describe_location(diagnosis: Diagnosis) -> written.Where:
    """Channel, dependence, regime, time and place of the mismatch between model and recording, for diagnosis.json.

    Channel, dependence, time and place are those of the named effects, channel and dependence of the first; without
    any, all are as located by the disturbances before the search.
    """
    location, findings = diagnosis.location, diagnosis.judgement.findings
    channel, depends = location.channel, location.depends_on
    times: tuple[tuple[float, float], ...] = ((0.0, diagnosis.take.T),)
    place: written.Circle | None = None
    if findings:
        effect = EFFECTS[findings[0].effect]
        depends = effect.depends_on
        # a change of mass acts on all channels
        channel = channel if effect.channel == "any" else effect.channel
        values = [{s: v for s, (v, _) in f.values.items()} for f in findings]
        circles = (written.Circle(x_m=v["x"], y_m=v["y"], radius_m=v["radius"]) for v in values if "radius" in v)
        place = next(circles, None)
        end = float(diagnosis.take.length_s.max())  # a time counts from where its recording begins
        times = tuple((v["t_s"], end) for v in values if "t_s" in v) or times
    else:
        if location.window is not None and "time" in depends:
            times = ((location.window.begin_s, location.window.end_s),)
        if location.place is not None and "place" in depends:
            place = written.Circle(x_m=location.place.x, y_m=location.place.y, radius_m=location.place.radius)
    return written.Where(
        channel=channel, depends_on=tuple(depends), regime=location.regime, time_s=times, place=place
    )  # fmt: skip


def _quote_parameters(
    parameters: Sequence[Parameter], values: dict[str, tuple[float, float]]
) -> dict[str, written.Quantity]:
    """Values, standard errors, units and whether at a bound, by symbol as printed, of an effect's `parameters`.

    `values` holds value and standard error (SI) by symbol; parameters that it lacks are left out.
    """
    quoted = [
        (p.quote(*values[p.symbol]), p.is_at_bound(values[p.symbol][0])) for p in parameters if p.symbol in values
    ]
    return {q.symbol: written.Quantity(value=q.value, se=q.se, unit=q.unit, at_bound=stuck) for q, stuck in quoted}


def _describe_finding(f: Finding, effect: Effect, gate_nats: float) -> written.NamedEffect:
    """Describe a named effect for diagnosis.json: equation, fitted parameters, gains, probability and a sentence."""
    quoted = [(p.meaning, p.quote(*f.values[p.symbol])) for p in effect.parameters if p.symbol in f.values]
    words = ", ".join(f"{m} {q.symbol} = {q.value:.3g} ± {q.se:.1g} {q.unit}".removesuffix(" –") for m, q in quoted)
    return written.NamedEffect(
        effect=f.effect, kind=effect.kind, twins=f.twins, probability=f.probability, equation=effect.equation,
        parameters=_quote_parameters(effect.parameters, f.values), heldout_gain=f.held_out.nats,
        heldout_gain_ci95=f.held_out.ci95, gain_nats=f.gain_nats,
        gate_nats=round(gate_nats, 1), sentence=f"{f.effect.replace('_', ' ')}: {words}",
        held=effect.confounded_with or None,
    )  # fmt: skip


def _describe_unknown(diagnosis: Diagnosis) -> written.UnknownPart:
    """Describe what no effect of the table explains: channel, dependence, and nats by which it makes the take likelier.

    It is the remainder beside the best fit; if that is nothing beyond chance, what corrections of the base model's own
    simplifications explain.
    """
    naming, seen = diagnosis.naming, diagnosis.naming.rest.seen
    if naming.unknown_nats > 0.0:
        channel = next(iter(seen.channel_nats()), None)
        depends_on = seen.depends_on(channel) if channel else ()
        held_out = diagnosis.judgement.unknown
        return written.UnknownPart(
            channel=channel, depends_on=depends_on, gain_nats=naming.unknown_nats,
            heldout_gain=held_out.nats if held_out else None,
        )  # fmt: skip
    entries, corrections = (
        [ENTRIES[name] for name in fitted_corrections(diagnosis.fit)],
        diagnosis.judgement.corrections,
    )
    return written.UnknownPart(
        channel=diagnosis.location.channel,
        depends_on=tuple(dict.fromkeys(d for entry in entries for d in entry.depends_on)),
        form="; ".join(entry.equation for entry in entries) or None,
        heldout_gain=corrections.nats if corrections else 0.0,
    )


def _describe_rivals(diagnosis: Diagnosis) -> list[written.Rival]:
    """Describe the next best fits: their effects, how many nats of penalised log-likelihood they lie behind, and why.

    Why a fit was not preferred is that it explains less, or that it cannot be told apart on this recording.
    """
    best, rows = diagnosis.fit, []
    for other in diagnosis.naming.rivals[: SUMMARY_LIMITS.max_rivals]:
        behind = best.penalised_log_likelihood - other.penalised_log_likelihood
        alone = are_indistinguishable(best, other, diagnosis.take)
        why = "cannot be told apart on this recording" if alone else f"explains {behind:.0f} nats less"
        rows.append(written.Rival(effects=named_effects(other), behind_nats=behind, why_not=why))
    return rows


def knot_columns(diagnosis: Diagnosis) -> Floats:
    """Columns (K, len(KNOT_UNITS)) at the K knots (0.25 s parts of the take): time, states, disturbances of the body.

    Disturbances are accelerations that the base model leaves unexplained ("before"), then those that the fit with the
    named effects leaves ("after").  KNOT_UNITS gives names and units of the columns.
    """
    b, m = diagnosis.pushes_before, diagnosis.pushes_before.states
    columns = [
        b.time_s, b.segment, m["p_x"], m["p_y"], m["theta"], m["v_x"], m["v_y"], m["omega"], m["delta"],
        m["delta_rate"], m["u_m"], m["alpha_f"], m["alpha_r"], *b.push.T, *diagnosis.pushes_after.push.T,
    ]  # fmt: skip
    assert len(WRENCH_CHANNELS) == b.push.shape[1]  # noqa: S101
    return np.column_stack(columns)


def track_columns(tracks: PredictedTracks) -> Floats:
    """Columns (K, len(TRACK_UNITS)) of measured and predicted positions; measured ones where predictions diverge.

    TRACK_UNITS gives their names and units: time, measured x and y, those predicted before and after effects are
    named, and 1 where a prediction starts.
    """
    filled = [np.where(np.isfinite(p), p, tracks.measured) for p in (tracks.before, tracks.after)]
    return np.column_stack([tracks.time_s, tracks.measured, *filled, tracks.starts])
