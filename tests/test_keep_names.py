"""Which names stay: what counts beside a remainder and without it, what a single segment shows, and copies of laws."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from weighed_names import GATE, Evidence, beside, explained_by_remainder, fit, state_of

from bcid.diagnosis.limits import SEARCH_LIMITS
from bcid.diagnosis.remainder.fit import RemainderFit
from bcid.diagnosis.remainder.functions import CHANNELS
from bcid.diagnosis.search import keep_names as keep_names_module
from bcid.diagnosis.search.keep_names import Lesser, _gain_beside_copies, keep_names
from bcid.diagnosis.search.refits import named_effects
from bcid.diagnosis.search.search_state import SearchState


def lesser(f: object, remainder: float) -> Lesser:
    return Lesser(f, beside(f, remainder))  # type: ignore[arg-type]


def keeping(
    monkeypatch: pytest.MonkeyPatch, nats: dict[tuple[str, ...], float], adds: dict[tuple[str, ...], float]
) -> tuple[SearchState, Evidence]:
    """A search beside refits of so much likelihood by their effects, and remainders that add so much to it."""
    likelihood = {frozenset(effects): value for effects, value in nats.items()}
    monkeypatch.setattr(
        keep_names_module, "refit_with_effects", lambda f, take, effects: fit(likelihood[frozenset(effects)], *effects)
    )

    def first_order(f: Any, name: str) -> float:
        less = frozenset(f.hypothesis.effects) - {name}
        return likelihood[frozenset(f.hypothesis.effects)] - likelihood[less]

    monkeypatch.setattr(keep_names_module, "first_order_nats", first_order)
    return state_of(), Evidence(monkeypatch, adds)


A, B, AB = ("yaw_scrub",), ("rear_toe",), ("yaw_scrub", "rear_toe")


@pytest.mark.parametrize(
    ("without", "remainder", "gains", "stays"),
    [
        (0.0, 0.0, 100.0, True),
        (0.0, 92.0, 8.0, True),  # a remainder explains nearly as much without it, but is many laws where it is one
        (0.0, 97.0, 3.0, False),  # it explains as much
        (0.0, 80.0, 20.0, True),
        (95.0, 0.0, 5.0, False),  # it adds next to nothing itself, whatever remainders say
        (95.0, -60.0, 5.0, False),
    ],
)
def test_a_name_must_gain_beside_a_remainder_and_without_one(
    without: float, remainder: float, gains: float, stays: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    looking, _ = keeping(monkeypatch, {A: 100.0, (): without}, {(): remainder})
    rest, _, kept, less = keep_names(looking, beside(fit(100.0, *A)))
    assert named_effects(rest.named) == (A if stays else ())
    if stays:
        assert kept == {"yaw_scrub": pytest.approx(gains)}
        assert less["yaw_scrub"].hypothesis.effects == ()
    else:
        assert (kept, less) == ({}, {})
        assert looking.added["yaw_scrub"] == pytest.approx(gains)


def test_the_weakest_goes_first_and_the_rest_is_weighed_anew(monkeypatch: pytest.MonkeyPatch) -> None:
    """Both add little beside each other; the stronger adds much once the weaker is gone."""
    nats = {AB: 100.0, A: 95.0, B: 92.0, (): 0.0}
    looking, at = keeping(monkeypatch, nats, {})
    rest, _, kept, _ = keep_names(looking, beside(fit(100.0, *AB)))
    assert named_effects(rest.named) == A
    assert kept == {"yaw_scrub": 95.0}
    assert (looking.refused, looking.added) == ({"rear_toe"}, {"rear_toe": 5.0})
    assert at.refitted == [A, ()]  # what would take the place of the stronger is asked once the weaker is gone


def test_what_was_tried_is_not_refitted(monkeypatch: pytest.MonkeyPatch) -> None:
    looking, at = keeping(monkeypatch, {AB: 300.0, A: 150.0, B: 100.0, (): 0.0}, {})
    looking.beside_remainder(fit(150.0, *A))
    at.refitted.clear()
    rest, _, kept, _ = keep_names(looking, beside(fit(300.0, *AB)))
    assert at.refitted == [B]
    assert kept == {"rear_toe": 150.0, "yaw_scrub": 200.0}
    assert named_effects(rest.named) == AB


@pytest.mark.parametrize(("share", "stays"), [(1.1, True), (0.9, False)])
def test_beside_a_large_remainder_a_name_must_add_more_than_smooth_functions_cannot_follow(
    share: float, stays: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    left = 5000.0
    gains = share * SEARCH_LIMITS.remainder_error * left
    assert gains > GATE
    looking, _ = keeping(monkeypatch, {A: gains, (): 0.0}, {A: left, (): left})
    rest, _, _, _ = keep_names(looking, beside(fit(gains, *A), left))
    assert named_effects(rest.named) == (A if stays else ())


@pytest.mark.parametrize(("grown", "stays"), [(180.0, True), (295.0, False)])
def test_a_name_is_weighed_against_a_remainder_that_grew_into_its_place(
    grown: float, stays: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Which a search from nothing may miss."""
    looking, _ = keeping(monkeypatch, {A: 100.0, (): 0.0}, {A: 200.0, (): 150.0})
    asked = list[tuple[str, ...]]()

    def leave_out(rest: RemainderFit, less: Any, take: Any) -> RemainderFit:
        asked.append(less.hypothesis.effects)
        return beside(less, grown, rest.seen)

    monkeypatch.setattr(keep_names_module, "leave_out", leave_out)
    monkeypatch.setattr(keep_names_module, "add_beside_remainder", lambda less, named, take: beside(named, 0.0))
    rest = beside(fit(100.0, *A), 200.0)._replace(on=np.arange(3))
    kept = keep_names(looking, rest)
    assert asked == [()]
    assert kept.gains == ({"yaw_scrub": 100.0} if stays else {})
    if not stays:
        assert kept.rest.log_evidence == grown
        assert kept.rest.seen.effects == ()


@pytest.mark.parametrize(("again", "stays"), [(310.0, True), (289.0, False)])
def test_the_remainder_beside_a_name_is_found_from_that_without_it_too(
    again: float, stays: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A remainder has many maxima: where the one without the name is the better one, it is no evidence against it."""
    looking, _ = keeping(monkeypatch, {A: 100.0, (): 0.0}, {A: 150.0, (): 150.0})
    some = np.arange(3)
    monkeypatch.setattr(
        keep_names_module, "leave_out", lambda rest, less, take: beside(less, 280.0, rest.seen)._replace(on=some)
    )

    def add(less: RemainderFit, named: Any, take: Any) -> RemainderFit:
        assert less.named.hypothesis.effects == ()
        return beside(named, again - 100.0, less.seen)._replace(on=some)

    monkeypatch.setattr(keep_names_module, "add_beside_remainder", add)
    kept = keep_names(looking, beside(fit(100.0, *A), 150.0)._replace(on=some))
    assert kept.gains == ({"yaw_scrub": again - 280.0} if stays else {})
    assert kept.rest.log_evidence == (again if stays else 280.0)


@pytest.mark.parametrize(("left", "stays"), [(0.9, True), (1.1, False)])
def test_beside_a_remainder_that_explains_the_same_a_name_must_leave_hardly_anything(
    left: float, stays: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What leaves more than smooth functions miss may do a part only of what is missing."""
    instead = 600.0
    left *= SEARCH_LIMITS.remainder_error * instead
    looking, _ = keeping(monkeypatch, {A: 600.0, (): 0.0}, {A: left, (): instead + left - 10.0})
    kept = keep_names(looking, beside(fit(600.0, *A), left)).gains
    assert set(kept) == (set(A) if stays else set())


# --- copies of laws that have names ----------------------------------------------------------------------------------

FULL = {"fx": 200.0, "mz": 5.0}
"""What the channels explain beside all names."""


def test_a_constant_law_is_named_where_its_channel_needs_nothing_else(monkeypatch: pytest.MonkeyPatch) -> None:
    """Else no constant could be named, as its copy would explain as much."""
    looking, at = keeping(monkeypatch, {A: 100.0, (): 0.0}, {})
    at.copies[()] = 100.0
    rest, _, kept, _ = keep_names(looking, beside(fit(100.0, *A)))
    assert kept == {"yaw_scrub": 100.0}
    assert at.copied == []
    assert named_effects(rest.named) == A


@pytest.mark.parametrize(("without", "gain"), [(298.0, 2.0), (270.0, 30.0), (150.0, 100.0)])
def test_copies_take_the_place_of_a_name_where_the_channel_is_needed_anyway(
    without: float, gain: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The name is weighed against the remainder with copies in such channels, or without where that is likelier."""
    looking, at = keeping(monkeypatch, {A: 100.0, (): 0.0}, {A: 200.0, (): 200.0})
    at.copies[()], at.seen[()] = without, explained_by_remainder(200.0, None, "fx")
    rest = beside(fit(100.0, *A), 200.0, explained_by_remainder(200.0, FULL))
    assert _gain_beside_copies(looking, rest, lesser(fit(0.0), 200.0), 100.0) == pytest.approx(gain)
    assert at.copied == [((), ("fx",))]
    kept = keep_names(looking, rest).gains
    assert set(kept) == ({"yaw_scrub"} if gain > GATE else set())


@pytest.mark.parametrize(("share", "needed"), [(1.05, True), (0.95, False)])
def test_a_channel_is_needed_that_adds_a_share_of_what_the_name_does(
    share: float, needed: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    looking, at = keeping(monkeypatch, {}, {})
    at.copies[()] = 1.0
    gain = 1000.0
    nats = share * SEARCH_LIMITS.needed_share * gain
    assert nats > GATE
    full = beside(fit(gain, *A), nats, explained_by_remainder(nats, {"fy": nats}))
    _gain_beside_copies(looking, full, lesser(fit(0.0), nats), gain)
    assert at.copied == ([((), ("fy",))] if needed else [])


def test_what_adds_too_little_anyway_is_not_weighed_against_copies(monkeypatch: pytest.MonkeyPatch) -> None:
    looking, at = keeping(monkeypatch, {A: GATE - 1.0, (): 0.0}, {A: 200.0, (): 200.0})
    at.copies[()] = 200.0
    rest = beside(fit(GATE - 1.0, *A), 200.0, explained_by_remainder(200.0, FULL))
    assert keep_names(looking, rest).gains == {}
    assert looking.added == {"yaw_scrub": GATE - 1.0}
    assert at.copied == [((), CHANNELS)]  # of what is left, when the name has gone


# --- what is no evidence for a name ------------------------------------------------------------------------------


@pytest.mark.parametrize(("alone", "stays"), [(GATE - 3.0, True), (GATE + 3.0, False)])
def test_one_odd_segment_makes_no_name(alone: float, stays: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """What a name adds in the segment where it adds most does not count."""
    gain = 2.0 * GATE
    looking, _ = keeping(monkeypatch, {A: gain, (): 0.0}, {})
    rest = keep_names(looking, beside(fit(gain, *A, each=(alone, 1.0)))).rest
    assert named_effects(rest.named) == (A if stays else ())


@pytest.mark.parametrize(("gain", "stays"), [(30.0, True), (18.0, False)])
def test_the_share_of_one_segment_does_not_count_beside_a_remainder_either(
    gain: float, stays: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A segment in which the base model is lost shows a law as much as others do, once a remainder follows it."""
    plain, alone, left = 400.0, 160.0, 30.0  # so that three fifths count, of which 12 nats must be exceeded
    looking, _ = keeping(monkeypatch, {A: plain, (): 0.0}, {A: left, (): plain + left - gain})
    kept = keep_names(looking, beside(fit(plain, *A, each=(alone, 1.0)), left)).gains
    assert kept == ({"yaw_scrub": gain} if stays else {})


@pytest.mark.parametrize(("nats", "stays"), [(150.0, True), (50.0, False)])
def test_what_smooth_functions_miss_of_a_remainder_counts_beside_one_alone(
    nats: float, stays: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without a remainder the name must exceed its gate, though a twentieth of what has no name is more."""
    plain, left = 3.0 * GATE, 2000.0
    assert plain < SEARCH_LIMITS.remainder_error * left < 150.0
    looking, _ = keeping(monkeypatch, {A: plain, (): 0.0}, {A: left, (): plain + left - nats})
    kept = keep_names(looking, beside(fit(plain, *A), left)).gains
    assert kept == ({"yaw_scrub": plain} if stays else {})


@pytest.mark.parametrize(("share", "stays"), [(1.1, True), (0.9, False)])
def test_a_name_must_add_more_than_evidence_without_it_is_converged_to(
    share: float, stays: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    instead = 5000.0
    gain = share * SEARCH_LIMITS.converged_share * instead
    assert gain > GATE
    looking, _ = keeping(monkeypatch, {A: instead + gain, (): 0.0}, {(): instead})
    rest = keep_names(looking, beside(fit(instead + gain, *A))).rest
    assert named_effects(rest.named) == (A if stays else ())


def test_a_name_is_left_out_of_the_fit_with_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """What was found before without it may be a lesser maximum, beside which it would seem to add much."""
    looking, _ = keeping(monkeypatch, {A: 9000.0, B: 8995.0, AB: 9000.0, (): 0.0}, {})
    looking.beside_remainder(fit(20.0, *B))  # the search came by there, and was stuck
    rest, _, kept, without = keep_names(looking, beside(fit(9000.0, *AB)))
    assert named_effects(rest.named) in (A, B)
    assert kept[rest.named.hypothesis.effects[0]] > 8000.0
    assert [f.penalised_log_likelihood for f in without.values()] == [0.0]
