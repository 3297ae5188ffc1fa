"""Where a fit of the base model begins, and what it does where a start leads out of the finite numbers."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
import pytest
from cars import CAR
from concealed import concealing

from bcid.effects.constants import Constants
from bcid.errors import PredictionDiverged
from bcid.likelihood import prepare
from bcid.likelihood.hypothesis import Hypothesis
from bcid.likelihood.limits import LIKELIHOOD_LIMITS
from bcid.likelihood.refit import evaluate_fixed

BASE = Hypothesis((), CAR, 2.012, Constants())
USUAL, OF_A_PART = "usual", "of a part"  # scales
SEGMENTS = 4 * prepare.PART_SEGMENTS


class Take(NamedTuple):
    """A take of which only the segments count."""

    segments: int
    start: Any = None

    def part(self, chosen: np.ndarray) -> Take:
        return Take(len(chosen))


class Found(NamedTuple):
    """What a refit that moves nothing returns: worth more, the lower the grip it begins with."""

    phi: np.ndarray
    scales: str
    segments: int = 1
    astray: float = 0.0  # nats per segment that it is worth less than what it began with
    start: Any = None
    hypothesis: Hypothesis = BASE

    @property
    def per_segment(self) -> np.ndarray:
        return np.full(self.segments, -1e-3 * BASE.car(self.phi).F_f_max - self.astray)

    @property
    def penalised_log_likelihood(self) -> float:
        return float(self.per_segment.sum())


class Refits:
    """Refits that end well but where `lost` says, of (segments, grip, scales), that they leave the finite numbers.

    Or `astray`, by how many nats per segment they end worse than they began.  As it stands the nominal car is lost.
    """

    def __init__(self, monkeypatch: pytest.MonkeyPatch, lost: Any, astray: Any = lambda *_: 0.0) -> None:
        self.whole: list[tuple[float, str]] = []  # grip and scales that refits of the whole take began with
        self._lost, self._astray = lost, astray
        monkeypatch.setattr(prepare, "refit", self)
        monkeypatch.setattr(prepare, "evaluate_fixed", self._lose_nominal)

    def _lose_nominal(self, *_: object) -> Any:
        raise PredictionDiverged("lost as it stands")

    def __call__(self, take: Take, hypothesis: Hypothesis, phi: np.ndarray, start: Any, scales: Any) -> Found:
        grip = round(hypothesis.car(phi).F_f_max)
        if take.segments == SEGMENTS:
            self.whole.append((grip, scales))
        if self._lost(take.segments, grip, scales):
            raise PredictionDiverged(f"lost at {grip}")
        return Found(phi, OF_A_PART, take.segments, self._astray(take.segments, grip, scales))


def never(*_: object) -> bool:
    return False


def fitted(segments: int = SEGMENTS) -> Any:
    return prepare.fit_base(Take(segments), BASE, USUAL)  # type: ignore[arg-type]


def grips(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """Of the cars that the fit begins with, best first."""
    begun: list[float] = []
    Refits(monkeypatch, lambda n, grip, scales: begun.append(grip))
    fitted()
    return sorted(begun[:-1])


def test_the_best_start_on_a_part_is_refitted_to_the_whole(monkeypatch: pytest.MonkeyPatch) -> None:
    best, *others = grips(monkeypatch)
    assert len(others) == len(prepare.FIRST_GRIPS)
    refits = Refits(monkeypatch, lambda n, grip, scales: n < SEGMENTS and grip == best)
    fitted()
    assert refits.whole == [(others[0], OF_A_PART)]


def test_where_the_scales_of_a_part_do_not_suit_the_whole_the_usual_ones_do(monkeypatch: pytest.MonkeyPatch) -> None:
    """The best start, of wider scales, before the next best."""
    best, *_ = grips(monkeypatch)
    refits = Refits(monkeypatch, lambda n, grip, scales: n == SEGMENTS and scales == OF_A_PART)
    fitted()
    assert refits.whole == [(best, OF_A_PART), (best, USUAL)]


def test_where_the_best_start_is_lost_on_the_whole_the_next_one_is_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    best, second, _ = grips(monkeypatch)
    refits = Refits(monkeypatch, lambda n, grip, scales: n == SEGMENTS and grip == best)
    assert BASE.car(fitted().phi).F_f_max == pytest.approx(second, abs=1.0)
    assert refits.whole[-1] == (second, OF_A_PART)


@pytest.mark.parametrize("least", [0, SEGMENTS])
def test_where_every_start_is_lost_the_fit_says_so(monkeypatch: pytest.MonkeyPatch, least: int) -> None:
    """On the part already, or on the whole."""
    Refits(monkeypatch, lambda n, grip, scales: n >= least)
    with pytest.raises(PredictionDiverged, match="lost at"):
        fitted()


def test_a_refit_to_the_whole_that_goes_astray_is_not_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    """But one from other scales, or from the next best start."""
    best, second, _ = grips(monkeypatch)
    far, near = 1.1 * LIKELIHOOD_LIMITS.max_whole_take_loss_nats, 0.9 * LIKELIHOOD_LIMITS.max_whole_take_loss_nats
    for by, whole in (far, [(best, OF_A_PART), (best, USUAL)]), (near, [(best, OF_A_PART)]):
        refits = Refits(monkeypatch, never, lambda n, grip, scales, by=by: by * (n == SEGMENTS and scales == OF_A_PART))
        fitted()
        assert refits.whole == whole
    refits = Refits(monkeypatch, never, lambda n, grip, scales: far * (n == SEGMENTS and grip == best))
    assert not fitted().astray
    assert refits.whole[-1] == (second, OF_A_PART)


def test_where_every_refit_to_the_whole_goes_astray_the_best_of_them_is_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    _, second, _ = grips(monkeypatch)
    far = 2.0 * LIKELIHOOD_LIMITS.max_whole_take_loss_nats
    Refits(monkeypatch, never, lambda n, grip, scales: (far if grip == second else 2.0 * far) * (n == SEGMENTS))
    assert BASE.car(fitted().phi).F_f_max == pytest.approx(second, abs=1.0)


@pytest.mark.parametrize(("by", "lost"), [(0.1, False), (1e6, False), (-0.1, False), (0.0, True)])
def test_of_a_short_take_the_better_fit_of_all_of_it_stands(
    monkeypatch: pytest.MonkeyPatch, by: float, lost: bool
) -> None:
    """Or the one that is there where the other leaves the finite numbers."""
    best, *_ = grips(monkeypatch)
    asked = list[int]()

    def again(n: int, *_: object) -> bool:
        asked.append(n)
        return len(asked) > 1 + len(prepare.FIRST_GRIPS)  # all that come after the starts

    Refits(monkeypatch, again if lost else never, never if lost else lambda *of: by * again(*of))
    found = fitted(prepare.PART_SEGMENTS)
    assert len(asked) == 1 + len(prepare.FIRST_GRIPS) + (2 if lost else 1)
    assert found.astray == min(by, 0.0)
    assert BASE.car(found.phi).F_f_max == pytest.approx(best, abs=1.0)


# --- never below the nominal car ---------------------------------------------------------------------------------


def worth(nats: float, start: str = "", scales: str = "") -> Any:
    return SimpleNamespace(penalised_log_likelihood=nats, start=start, scales=scales, hypothesis="base")


@pytest.mark.parametrize(
    ("settled", "again", "stands"),
    [
        (90.0, 200.0, 100.0),  # the nominal car is less likely as it stands: nothing more is tried
        (150.0, 200.0, 200.0),
        (150.0, 99.0, 100.0),
        (150.0, None, 100.0),  # which leaves the finite numbers
        (None, 200.0, 100.0),
    ],
)
def test_a_fit_is_never_less_likely_than_the_start_once_that_has_settled(
    settled: float | None, again: float | None, stands: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """From where the start has settled it is fitted again, and the likelier fit is taken."""
    given = list[tuple[Any, ...]]()

    def at_start(*asked: Any) -> Any:
        assert asked == ("take", "base", "phi", "of the fit")
        if settled is None:
            raise PredictionDiverged
        return worth(settled, "settled start", "settled scales")

    def refit_again(*asked: Any) -> Any:
        given.append(asked)
        if again is None:
            raise PredictionDiverged
        return worth(again)

    monkeypatch.setattr(prepare, "evaluate_fixed", at_start)
    monkeypatch.setattr(prepare, "refit", refit_again)
    anything: Any = prepare
    found = anything._not_below_start(worth(100.0, scales="of the fit"), "take", "phi")
    assert found.penalised_log_likelihood == stands
    likelier = settled is not None and settled > 100.0
    assert given == ([("take", "base", "phi", "settled start", "settled scales")] if likelier else [])


def test_the_base_model_s_fit_is_no_less_likely_than_the_car_that_it_began_with() -> None:
    fit, take = concealing(yaw_scrub=20.0)
    nominal = evaluate_fixed(take, fit.hypothesis, fit.hypothesis.phi_of(fit.hypothesis.nominal), fit.scales)
    assert fit.penalised_log_likelihood >= nominal.penalised_log_likelihood
