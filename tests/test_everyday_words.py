"""Sizes of findings in everyday words: every effect has a phrase, and every phrase suits its parameters' units."""

from __future__ import annotations

import re
from collections import Counter
from string import Formatter

import pytest

from bcid.documents.diagnosis import NamedEffect, Quantity
from bcid.effects.entry import Effect, Parameter, parse_unit
from bcid.effects.table import EFFECTS
from bcid.report.everyday_words import PHRASES, in_everyday_units, size_in_words

EVERYDAY = re.compile(r"\d( (ms|s|cm|m|%|N|N m|W|m/s|m/s²)(?= |,|$)|°)")


def found(effect: Effect, sign: float = 1.0) -> NamedEffect:
    """A finding of the size that searches start from, with a tenth of it as its standard error."""
    quoted = [p.quote(sign * p.size if p.low < 0.0 else p.size or 1.0, 0.1 * p.size) for p in effect.parameters]
    parameters = {q.symbol: Quantity(value=q.value, se=q.se, unit=q.unit) for q in quoted}
    return NamedEffect(effect=effect.id, parameters=parameters)


def test_every_effect_has_its_phrase() -> None:
    assert set(PHRASES) == set(EFFECTS)


@pytest.mark.parametrize("effect", EFFECTS.values(), ids=lambda e: e.id)
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_every_phrase_says_a_size_in_a_unit_that_people_use(effect: Effect, sign: float) -> None:
    words = size_in_words(found(effect, sign))
    assert words
    assert "{" not in words
    assert "rad" not in words
    assert EVERYDAY.search(words), words
    assert "−" not in words, "the phrase tells the direction, not the number"


@pytest.mark.parametrize("effect", EFFECTS.values(), ids=lambda e: e.id)
def test_every_amplitude_is_in_its_phrase(effect: Effect) -> None:
    phrase = PHRASES[effect.id]
    for text in filter(None, (phrase.text, phrase.negative)):
        named = {name for _, name, _, _ in Formatter().parse(text) if name}
        told = {s for name in named for s in (phrase.sizes[name].symbols if name in phrase.sizes else (name,))}
        quoted = {p.quote(1.0, None).symbol for p in effect.amplitude_parameters}
        assert quoted <= told


@pytest.mark.parametrize("effect", EFFECTS.values(), ids=lambda e: e.id)
def test_what_a_size_is_multiplied_by_leads_to_a_unit_of_the_field(effect: Effect) -> None:
    """Times, lengths and angles may be multiplied in, nothing else: kilograms stay as they are."""
    known = {p.symbol: p for p in effect.parameters}
    for name, size in PHRASES[effect.id].sizes.items():
        units = {known[s].unit for s in size.symbols}
        assert len(units) == 1, name
        if size.unit is not None:
            before, after = (Counter(dict(parse_unit(u))) for u in (units.pop(), size.unit))
            # an angle per newton is the only size whose mass is multiplied away
            assert before["kg"] == after["kg"] or effect.id == "steering_compliance"


@pytest.mark.parametrize("effect", EFFECTS.values(), ids=lambda e: e.id)
def test_a_phrase_has_two_directions_only_where_the_parameter_has_two_signs(effect: Effect) -> None:
    first: Parameter = effect.amplitude_parameters[0]
    if PHRASES[effect.id].negative is not None:
        assert first.low < 0.0
        assert size_in_words(found(effect, 1.0)) != size_in_words(found(effect, -1.0))


@pytest.mark.parametrize(("value", "se", "unit", "expected"), [
    (0.023, 0.002, "rad", "1.32 ± 0.11°"), (0.0603, 0.0041, "s", "60 ± 4 ms"), (2.4, 0.3, "s", "2.4 ± 0.3 s"),
    (0.2, 0.01, "–", "20.0 ± 1.0 %"), (0.15, 0.02, "m", "15 ± 2 cm"), (30.4, 0.2, "N", "30.4 ± 0.2 N"),
    (0.2, 0.0, "rad", "11.5°"), (0.2, float("nan"), "1", "20.0 %"),
])  # fmt: skip
def test_units_that_people_use(value: float, se: float, unit: str, expected: str) -> None:
    assert in_everyday_units(value, se, unit) == expected


def test_a_floor_that_tilts() -> None:
    slope = {"g_x": Quantity(value=0.12, se=0.003, unit="m/s²"), "g_y": Quantity(value=-0.16, se=0.003, unit="m/s²")}
    words = size_in_words(NamedEffect(effect="floor_slope", parameters=slope))
    assert words == "a floor that falls by 2.04 ± 0.03 cm on each metre, which is 1.168 ± 0.018°"


def test_a_negative_size_turns_the_phrase_around() -> None:
    left, right = (
        size_in_words(NamedEffect(effect="steering_offset", parameters={"o": Quantity(value=v, se=0.001, unit="rad")}))
        for v in (0.02, -0.02)
    )
    assert "to the left" in left
    assert right == left.replace("left", "right")


@pytest.mark.parametrize("finding", [
    NamedEffect(effect="of another version"), NamedEffect(effect="steering_delay"),
    NamedEffect(effect="steering_delay", parameters={"tau": Quantity(value=None, se=None, unit="s")}),
])  # fmt: skip
def test_what_is_not_known_is_not_said(finding: NamedEffect) -> None:
    assert size_in_words(finding) == ""


@pytest.mark.parametrize(("d_x", "d_y", "place"), [
    (0.05, 0.01, "5.0 ± 0.2 cm ahead and 1.0 ± 0.2 cm to the left of"),
    (-0.05, -0.01, "5.0 ± 0.2 cm behind and 1.0 ± 0.2 cm to the right of"),
])  # fmt: skip
def test_where_the_tracked_point_lies(d_x: float, d_y: float, place: str) -> None:
    offset = {s: Quantity(value=v, se=0.002, unit="m") for s, v in (("d_x", d_x), ("d_y", d_y))}
    words = size_in_words(NamedEffect(effect="marker_offset", parameters=offset))
    assert words == f"the tracked point lies {place} the centre of gravity"
