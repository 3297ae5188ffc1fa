"""The page of a diagnosis, and its verdict in a sentence.

jinja2 with everything escaped, pictures embedded, no script, no outside resource.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import floor, log10
from pathlib import Path
from typing import Any

from bcid import __version__
from bcid.aliases import Floats
from bcid.effects.entry import unit_in_words
from bcid.effects.table import ENTRIES
from bcid.report.before_after_figures import proof_pictures
from bcid.report.knots import VARIABLES, where_of, windows_of
from bcid.report.templates import template
from bcid.report.where_figures import where_pictures

CHANNELS = {
    "fx": "forward force (fx)", "fy": "side force (fy)", "mz": "yaw moment (mz)", "steering": "steering",
    "motor": "motor", "pose": "tracked pose", "time": "timing of poses and commands",
}  # fmt: skip
GREEK = {
    "tau": "τ", "sigma": "σ", "kappa": "κ", "epsilon": "ε", "rho": "ρ", "psi": "ψ", "inverse_P": "1/P",
}  # fmt: skip
FOLDED = 8  # rows from which a table is folded

_SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")

_FIELDS = {
    "vehicle": "", "recordings": (), "duration_s": None, "simulation": "", "findings": (), "unknown": None,
    "contacts": (), "corrections": (), "base": None, "rivals": (), "placebos": (), "horizons": (), "not_excited": (),
    "next_manoeuvre": None,
}  # fmt: skip
_FINDING: dict[str, Any] = {
    "kind": "", "twins": (), "probability": None, "equation": "", "parameters": {}, "heldout_gain": None,
    "gain_nats": None, "sentence": "",
}  # fmt: skip
_MANOEUVRE = {"name": "", "separates": (), "why": "", "file": None, "score": None}
_UNKNOWN = {"channel": None, "depends_on": (), "form": None, "heldout_gain": None}
_HORIZON = dict.fromkeys(
    (
        "lost",
        "nmse_given",
        "given_lost",
        "nmse_before",
        "before_ci95",
        "nmse_after",
        "after_ci95",
        "nmse_floor",
        "ratio",
        "ratio_ci95",
    )
)


def write_diagnosis_page(
    diagnosis: Mapping[str, Any], knots: Mapping[str, Floats], tracks: Mapping[str, Floats], path: Path
) -> None:
    """Write the page of `diagnosis` to `path`."""
    page = template(
        "diagnosis.html.j2", plain=plain, number=number, unit=unit, symbol=symbol, p=probability, nmse=thousandths,
        either=either, fixed=fixed, change=change,
    )  # fmt: skip
    text = page.render(
        version=__version__,
        sentence=verdict_sentence(diagnosis),
        d=_completed(diagnosis),
        mismatch={"detected": False, "p_value": None} | dict(diagnosis.get("mismatch") or {}),
        where=where_of(diagnosis),
        windows=windows_of(diagnosis),
        channels=CHANNELS,
        entering=[(c, n) for c, n in (diagnosis.get("channels") or {}).items() if n > 0.0],
        entries=ENTRIES,
        with_error=with_error,
        folded=FOLDED,
        after=_after(diagnosis),
        where_pictures=where_pictures(diagnosis, knots),
        proof_pictures=proof_pictures(diagnosis, knots, tracks),
    )
    path.write_text(text, encoding="utf-8")


def _after(diagnosis: Mapping[str, Any]) -> str:
    """What is different after, in words; empty where nothing is."""
    d = _completed(diagnosis)
    if d["findings"]:
        return f"with {both([plain(f['effect']) for f in d['findings']])}"
    return "with the base model’s own simplifications adjusted" if d["corrections"] else ""


def _completed(diagnosis: Mapping[str, Any]) -> dict[str, Any]:
    """With every field that the page asks for."""
    d = _with(_FIELDS, diagnosis)
    return d | {
        "findings": [_with(_FINDING, f) for f in d["findings"]],
        "horizons": [_with(_HORIZON, h) for h in d["horizons"]],
        "unknown": _with(_UNKNOWN, d["unknown"]) if d["unknown"] else None,
        "next_manoeuvre": _with(_MANOEUVRE, d["next_manoeuvre"]) if d["next_manoeuvre"] else None,
        "base": list((d["base"] or {}).get("parameters") or ()),
    }


def _with(defaults: Mapping[str, Any], given: Mapping[str, Any]) -> dict[str, Any]:
    return {**defaults, **{k: v for k, v in given.items() if v is not None}}


def verdict_sentence(diagnosis: Mapping[str, Any]) -> str:
    """What was found, how large, and how much it helps on data held out."""
    d = _completed(diagnosis)
    say = {"named": _named, "ambiguous": _ambiguous, "unknown": _unknown, "nothing-found": _nothing}
    return say[d["verdict"]](d)


def _named(d: Mapping[str, Any]) -> str:
    kinds = {f["kind"] for f in d["findings"]}
    lead = "The recording is off, not the vehicle" if kinds == {"measurement"} else "Missing in the simulation"
    items = "; ".join(_item(f, kinds) for f in d["findings"])
    return f"{lead}: {items}. {_help(d, 'With ' + _them(d))}{_remainder(d)}".rstrip()


def _ambiguous(d: Mapping[str, Any]) -> str:
    kinds = {f["kind"] for f in d["findings"]}
    alone = [_item(f, kinds) for f in d["findings"] if not f["twins"]]
    unclear = [
        f"{_item(f, kinds)}, or instead {either([plain(t) for t in f['twins']])}" for f in d["findings"] if f["twins"]
    ]
    certain = f"Missing in the simulation: {'; '.join(alone)}. " if alone else ""
    more = "Something more" if alone else "Something"
    missing = f"{more} is missing, and this recording cannot tell which"
    if kinds == {"measurement"} and not alone:
        missing = "The recording is off, not the vehicle, though two causes would look the same"
    return (
        f"{certain}{missing}: {'; and: '.join(unclear)}. "
        f"{_help(d, 'With the first named' if len(d['findings']) == 1 else 'With those named first')}{_remainder(d)}"
    ).rstrip()


def _unknown(d: Mapping[str, Any]) -> str:
    if d["unknown"]:
        return f"Something is missing that no named effect explains: {_left(d['unknown'])}."
    names = ", ".join(plain(c["correction"]) for c in d["corrections"])
    adjusted = f"; adjusting the base model's own simplifications ({names}) takes up part of it" if names else ""
    return f"Something is missing that no named effect explains{adjusted}."


def _nothing(d: Mapping[str, Any]) -> str:
    mismatch, fit = d.get("mismatch") or {}, d.get("fit") or {}
    p = probability(mismatch.get("p_value"))
    if mismatch.get("detected"):
        return f"A mismatch is seen ({p}), but nothing that was tried explains it well enough to be named."
    before, lowest = fit.get("nmse_before"), fit.get("nmse_floor")
    figures = ""
    if before is not None and lowest:
        figures = (
            f": {fit['horizon_s']:g} s ahead the held-out error is {before / lowest:.2f} times what noise alone leaves"
        )
    stands_out = f", and no place or time stands out ({p})" if p else ""
    return f"Nothing is missing beyond the noise floor{figures}{stands_out}."


def _item(finding: Mapping[str, Any], kinds: set[str]) -> str:
    """An effect with its values; its kind where that is not the vehicle's own and not said already."""
    kind = finding["kind"]
    told = f" ({kind})" if kind in ("measurement", "environment") and kinds != {"measurement"} else ""
    values = ", ".join(
        f"{symbol(s)} = {with_error(p.get('value'), p.get('se'), p.get('unit'))}"
        f"{' (at its bound)' if p.get('at_bound') else ''}"
        for s, p in finding["parameters"].items()
    )
    return f"{plain(finding['effect'])}{told}{', ' if values else ''}{values}"


def _them(d: Mapping[str, Any]) -> str:
    return "it" if len(d["findings"]) == 1 else "them"


def _help(d: Mapping[str, Any], lead: str) -> str:
    """How much the held-out error falls, from the `fit` of the diagnosis."""
    fit = d.get("fit") or {}
    before, after, lowest = (fit.get(f"nmse_{k}") for k in ("before", "after", "floor"))
    if not before or after is None:
        return ""
    sign, verb = (1.0, "falls") if after <= before else (-1.0, "rises")
    share = sign * 100.0 * (1.0 - after / before)
    text = f"{lead} the held-out {fit['horizon_s']:g} s error (NMSE) {verb} by {share:.{0 if share < 99 else 1}f} %"
    ratio = fit.get("ratio_ci95")
    if ratio and None not in ratio:
        low, high = sorted(sign * 100.0 * (1.0 - r) for r in ratio)
        text += f" (95 % interval {_signed(f'{low:.0f}')} to {_signed(f'{high:.0f}')} %)"
    if lowest:
        text += f", to {after / lowest:.2f} times the noise floor"
    return text + ". "


def _remainder(d: Mapping[str, Any]) -> str:
    return f"Something more is left that no named effect explains: {_left(d['unknown'])}." if d["unknown"] else ""


def _left(unknown: Mapping[str, Any]) -> str:
    channel = unknown["channel"]
    depends = both([plain(n) for n in unknown["depends_on"]])
    text = f"it acts on the {CHANNELS.get(channel, channel)}" if channel else "its channel is not clear"
    text += f" and depends on {depends}" if depends else ""
    lies = unknown.get("lies")
    text += f"; the pushes lie {lies}" if lies else ""
    return text + (f"; a short form fits it: {unknown['form']}" if unknown["form"] else "; no short form fits it")


def both(words: Sequence[str]) -> str:
    """A list in words.

    >>> both(["a", "b", "c"])
    'a, b and c'
    """
    return f"{', '.join(words[:-1])} and {words[-1]}" if len(words) > 1 else "".join(words)


def either(words: Sequence[str]) -> str:
    """A choice in words.

    >>> either(["a", "b", "c"])
    'a, b or c'
    """
    return f"{', '.join(words[:-1])} or {words[-1]}" if len(words) > 1 else "".join(words)


def plain(name: str) -> str:
    """An id in words.

    >>> plain("steering_delay+motor_delay"), plain("v_x")
    ('steering delay with motor delay', 'forward speed')
    """
    return VARIABLES[name][0] if name in VARIABLES else name.replace("_", " ").replace("+", " with ")


def symbol(name: str) -> str:
    """A parameter as the equation has it."""
    return GREEK.get(name, name)


def unit(text: str | None) -> str:
    """A unit as an engineer writes it.

    >>> unit("kg s^-1"), unit("kg m^4")
    ('N s/m', 'kg m⁴')
    """
    words = unit_in_words(text or "1")
    return "" if words == "–" else words


def number(value: float | None, digits: int = 3) -> str:
    """A number to some digits, a dash where there is none.

    >>> number(1234.5), number(0.04567, 2), number(2.1e-5, 2), number(None)
    ('1230', '0.046', '2.1 × 10⁻⁵', '–')
    """
    if value is None:
        return "–"
    mantissa, exponent = f"{value:.{digits - 1}e}".split("e")
    power = int(exponent)
    if not -4 < power < 5:
        return f"{_signed(mantissa)} × 10{str(power).translate(_SUPERSCRIPTS)}"
    return _rounded(value, digits - 1 - power)


def fixed(value: float, places: int) -> str:
    """A number to so many decimals."""
    return _signed(f"{value:.{places}f}")


def _rounded(value: float, places: int) -> str:
    """To so many decimals, or to tens and hundreds where negative."""
    return _signed(f"{round(value, places):.{max(places, 0)}f}")


def _signed(text: str) -> str:
    return text.replace("-", "−")


def with_error(value: float | None, se: float | None, of_unit: str | None = None) -> str:
    """A value ± its standard error, rounded by the error, with its unit.

    >>> with_error(0.0603, 0.0041, "m s^-1"), with_error(3594.0, 118.0, "kg m^2"), with_error(3.51e-5, 2e-6)
    ('0.060 ± 0.004 m/s', '3590 ± 120 kg m²', '(3.5 ± 0.2) × 10⁻⁵')
    """
    after = f" {unit(of_unit)}".rstrip()
    if value is None or not se or se < 0.0:
        return f"{number(value)}{after if value is not None else ''}"
    power = floor(log10(max(abs(value), se)))
    if not -4 < power < 5:
        inner = with_error(value / 10.0**power, se / 10.0**power)
        return f"({inner}) × 10{str(power).translate(_SUPERSCRIPTS)}{after}"
    lead = floor(log10(se))
    places = -lead + (1 if se / 10.0**lead < 1.95 else 0)
    return f"{_rounded(value, places)} ± {_rounded(se, places)}{after}"


def probability(p: float | None) -> str:
    """A p-value.

    >>> probability(0.0004), probability(0.43), probability(None)
    ('p < 0.001', 'p = 0.43', '')
    """
    if p is None:
        return ""
    return "p < 0.001" if p < 0.001 else f"p = {p:.2g}"


def change(ratio: float | None) -> str:
    """After over before, as a change.

    >>> change(0.34), change(1.2), change(1.0), change(None)
    ('−66 %', '+20 %', '0 %', '–')
    """
    return (
        "–" if ratio is None else _signed(f"{100.0 * (ratio - 1.0):+.0f} %").replace("+0 ", "0 ").replace("−0 ", "0 ")
    )


def thousandths(value: float | None) -> str:
    """An NMSE as multiples of 10^-3."""
    return number(None if value is None else 1e3 * value)
