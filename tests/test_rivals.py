"""What stands beside a fit: one rival for each exchange, none for what is held already, and exchanges that win."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from bcid.diagnosis import rivals, search
from bcid.diagnosis.rivals import distinct, settled

TAKE: Any = None


def fit(bic: float, *effects: str) -> Any:
    return SimpleNamespace(hypothesis=SimpleNamespace(effects=effects, assumed=()), bic=bic)


def test_a_rival_has_one_effect_in_place_of_another() -> None:
    best = fit(100.0, "yaw_scrub", "rear_toe")
    better, worse = fit(95.0, "rear_toe", "yaw_coulomb"), fit(90.0, "yaw_coulomb", "rear_toe")
    fewer, more = fit(99.0, "yaw_scrub"), fit(99.0, "yaw_scrub", "rear_toe", "motor_sag")
    same, other = fit(99.5, "rear_toe", "yaw_scrub"), fit(99.0, "motor_sag", "yaw_coulomb")
    assert distinct(best, [worse, better, fewer, more, same, other]) == (better,)


def beside(monkeypatch: pytest.MonkeyPatch, exchanges: dict[tuple[str, ...], list[Any]]) -> None:
    """Refits that need no take: `exchanges` of a fit by its effects, best first."""
    monkeypatch.setattr(rivals, "each_left_out", lambda f, known, take: dict.fromkeys(f.hypothesis.effects))
    monkeypatch.setattr(rivals, "_exchanged", lambda f, *_: exchanges[f.hypothesis.effects])
    monkeypatch.setattr(rivals, "placed", lambda f, take: f)


def test_an_exchange_that_wins_is_exchanged_in_turn(monkeypatch: pytest.MonkeyPatch) -> None:
    first, second, third = fit(10.0, "a", "b"), fit(20.0, "a", "c"), fit(30.0, "d", "c")
    stale = fit(9.0, "e", "b")  # beside the first one alone
    beside(
        monkeypatch, {("a", "b"): [second, stale], ("a", "c"): [third, first], ("d", "c"): [second, fit(5.0, "d", "f")]}
    )
    found = settled(first, TAKE, TAKE, ())
    assert found.best is third
    assert [f.hypothesis.effects for f in found.others] == [("a", "c"), ("d", "f")]
    assert set(found.without) == {"c", "d"}


def test_rivals_of_what_is_left_do_not_hold_what_was_dropped(monkeypatch: pytest.MonkeyPatch) -> None:
    dropped = fit(100.0, "yaw_scrub", "motor_sag")
    left, twin = fit(98.0, "yaw_scrub"), fit(97.0, "quadratic_drag")
    beside(monkeypatch, {("yaw_scrub",): [twin]})
    old = (fit(96.0, "quadratic_drag", "motor_sag"),)
    none = fit(0.0)
    found = search.Search(none, none, dropped, {}, old, TAKE, 0.0, TAKE)
    assert found.reduced(left, TAKE).others == (twin,)
