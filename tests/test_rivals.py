"""What stands beside a fit: one rival for each exchange, none for what is held already, and exchanges that win."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from cars import CAR

from bcid.diagnosis.judge import held_out, proxies
from bcid.diagnosis.locate.mismatch import RemainingMismatch
from bcid.diagnosis.locate.pushes import STATE_NAMES, Disturbances, push_reduction_shares
from bcid.diagnosis.locate.regression import DisturbanceRegression
from bcid.diagnosis.search import forward_backward, rivals
from bcid.diagnosis.search.refits import effects_at_bounds
from bcid.diagnosis.search.rivals import distinct_rivals, exchange_until_stable
from bcid.diagnosis.search.screen import CandidateEffect
from bcid.effects.constants import Constants
from bcid.effects.corrections import RAW_COMMANDS
from bcid.effects.table import ENTRIES
from bcid.errors import PredictionDiverged
from bcid.likelihood.hypothesis import Hypothesis
from bcid.likelihood.score_test import Trial, TrialChanges

TAKE: Any = None
NOTHING_LEFT = DisturbanceRegression("fx", 0.0, {}, (), 0.0, None, 0.25)


def fit(penalised_log_likelihood: float, *effects: str) -> Any:
    return SimpleNamespace(
        hypothesis=SimpleNamespace(effects=effects, assumed=()), penalised_log_likelihood=penalised_log_likelihood
    )


def test_a_rival_has_one_effect_in_place_of_another() -> None:
    best = fit(100.0, "yaw_scrub", "rear_toe")
    better, worse = fit(95.0, "rear_toe", "yaw_coulomb"), fit(90.0, "yaw_coulomb", "rear_toe")
    fewer, more = fit(99.0, "yaw_scrub"), fit(99.0, "yaw_scrub", "rear_toe", "motor_sag")
    same, other = fit(99.5, "rear_toe", "yaw_scrub"), fit(99.0, "motor_sag", "yaw_coulomb")
    assert distinct_rivals(best, [worse, better, fewer, more, same, other]) == (better,)


def beside(monkeypatch: pytest.MonkeyPatch, exchanges: dict[tuple[str, ...], list[Any]]) -> None:
    """Refits that need no take: `exchanges` of a fit by its effects, best first."""
    monkeypatch.setattr(rivals, "leave_one_out", lambda f, known, take: dict.fromkeys(f.hypothesis.effects))
    monkeypatch.setattr(rivals, "_refit_exchanges", lambda f, *_: exchanges[f.hypothesis.effects])
    monkeypatch.setattr(rivals, "refine_places", lambda f, take: f)


def test_an_exchange_that_wins_is_exchanged_in_turn(monkeypatch: pytest.MonkeyPatch) -> None:
    first, second, third = fit(10.0, "a", "b"), fit(20.0, "a", "c"), fit(30.0, "d", "c")
    stale = fit(9.0, "e", "b")  # beside the first one alone
    beside(
        monkeypatch, {("a", "b"): [second, stale], ("a", "c"): [third, first], ("d", "c"): [second, fit(5.0, "d", "f")]}
    )
    found = exchange_until_stable(first, TAKE, TAKE, ())
    assert found.best is third
    assert [f.hypothesis.effects for f in found.rivals] == [("a", "c"), ("d", "f")]
    assert set(found.leave_one_out) == {"c", "d"}


def test_a_single_name_keeps_its_rivals_when_a_correction_goes(monkeypatch: pytest.MonkeyPatch) -> None:
    """Those that were refitted beside it hold the correction, and are none: others are looked for."""
    fall = ("tyre_fall", "yaw_scrub")
    before, after = fit(10.0, *fall), fit(9.0, "yaw_scrub")
    tried = [fit(9.5, "tyre_fall", "yaw_coulomb")]
    monkeypatch.setattr(forward_backward, "leave_one_out", lambda f, known, take: {})
    monkeypatch.setattr(
        forward_backward, "exchange_until_stable", lambda best, *_: rivals.Alternatives(best, {}, ("looked for",))
    )  # type: ignore[arg-type]
    problem: Any = SimpleNamespace(take=TAKE, trials=TAKE, corrected=None, base=None)
    state: Any = SimpleNamespace(best=before, tried=tried, promising=())
    assert forward_backward._find_alternatives(before, problem, state).rivals == tuple(tried)
    assert forward_backward._find_alternatives(after, problem, state).rivals == ("looked for",)
    assert distinct_rivals(after, tried) == ()
    monkeypatch.setattr(forward_backward, "refit_with_effects", lambda f, take, effects: fit(9.0, *effects))
    monkeypatch.setattr(forward_backward, "_is_certain", lambda f, name: name != "tyre_fall")
    assert forward_backward._eliminate_backward(before, TAKE, 7.0).hypothesis.effects == ("yaw_scrub",)


def test_half_a_take_bends_a_trusted_simulation_as_far_as_the_whole_does(monkeypatch: pytest.MonkeyPatch) -> None:
    trusting = Hypothesis((), CAR, 2.012, Constants(), assumed=("motor_lag",)).trust_simulation([0.06], 0.02)
    take: Any = SimpleNamespace(segments=4, rows=lambda chosen: chosen, part=lambda chosen: None)
    made = list[Any]()
    monkeypatch.setattr(held_out, "refit", lambda part, hypothesis, *_: made.append(hypothesis))
    tangent = SimpleNamespace(A=np.zeros((4, 1)), J=np.zeros((4, 1)))
    whole: Any = SimpleNamespace(hypothesis=trusting, phi=None, start=np.zeros((4, 1)), scales=None, tangent=tangent)
    held_out.refit_on_half(whole, take, np.array([0, 2]))
    phi = trusting.with_effects().phi_of(CAR, [0.06])
    stiffness = [h.with_effects().prior(phi)[1] for h in (made[0], trusting)]
    np.testing.assert_allclose(stiffness[0], 0.5 * stiffness[1])


def test_rivals_of_what_is_left_do_not_hold_what_was_dropped(monkeypatch: pytest.MonkeyPatch) -> None:
    dropped = fit(100.0, "yaw_scrub", "motor_sag")
    left, twin = fit(98.0, "yaw_scrub"), fit(97.0, "quadratic_drag")
    beside(monkeypatch, {("yaw_scrub",): [twin]})
    old = (fit(96.0, "quadratic_drag", "motor_sag"),)
    none = fit(0.0)
    found = forward_backward.SearchResult(
        none, none, dropped, {}, old, TAKE, 0.0, TrialChanges(TAKE, []), ("motor_sag", "rear_toe")
    )
    assert found.reduce_to(left, TAKE, ("motor_sag",)).rivals == (twin,)


def test_a_stand_in_comes_back_as_no_rival(monkeypatch: pytest.MonkeyPatch) -> None:
    """Neither by the score test nor from its size."""
    given = {}

    def rest(fit: Any, take: Any, trials: TrialChanges, known: Any, promising: Any) -> rivals.Alternatives:
        given.update(tried={t.effect for t in trials.trials}, promising=promising)
        return rivals.Alternatives(fit, {}, ())

    monkeypatch.setattr(forward_backward, "exchange_until_stable", rest)
    trials = TrialChanges(TAKE, [Trial(name, [], slice(0)) for name in ("motor_sag", "rear_toe", "yaw_coulomb")])
    none = fit(0.0)
    found = forward_backward.SearchResult(none, none, none, {}, (), TAKE, 0.0, trials, ("motor_sag", "rear_toe"))
    found.reduce_to(none, TAKE, ("motor_sag",))
    assert given == {"tried": {"rear_toe", "yaw_coulomb"}, "promising": ("rear_toe",)}


def test_under_pushes_an_effect_is_exchanged_for_others_at_their_sizes(monkeypatch: pytest.MonkeyPatch) -> None:
    """A score test, which tells nothing there, is believed of places alone."""
    scored = [CandidateEffect("motor_sag", [1.0], 1e6), CandidateEffect("rough_patch", [1.0] * 4, 1e6)]
    held, less = fit(100.0, "yaw_scrub"), fit(10.0)
    less.hypothesis.entries = ENTRIES
    twin, placed = fit(99.0, "yaw_coulomb"), fit(98.0, "rough_patch")
    asked = []

    def sized(fit: Any, take: Any, names: Any, least: float) -> tuple[list[Any], tuple[str, ...]]:
        asked.append((fit, list(names), least))
        return [twin], ()

    monkeypatch.setattr(rivals, "screen_effects", lambda *_: scored)
    monkeypatch.setattr(rivals.refits, "refit_along_tangent", lambda fit, take, c: {"rough_patch": placed}[c.effect])
    monkeypatch.setattr(rivals.refits, "refit_fully", lambda fit, take: fit)
    monkeypatch.setattr(
        rivals.refits, "rank_credible_fits", lambda fits, take: sorted(fits, key=lambda f: -f.penalised_log_likelihood)
    )
    monkeypatch.setattr(rivals, "refit_from_sizes", sized)
    take: Any = SimpleNamespace(pushed=True)
    found = rivals._refit_exchanges(
        held, take, TrialChanges(TAKE, []), {"yaw_scrub": less}, ("yaw_scrub", "yaw_coulomb")
    )
    assert found == [twin, placed]
    assert asked == [(less, ["yaw_coulomb"], 90.0)]


@pytest.mark.parametrize(("gained", "enough"), [(30.0, True), (20.0, False), (11.0, False)])
def test_a_further_effect_explains_a_fair_share_of_what_is_left(gained: float, enough: bool) -> None:
    """A quarter of what trees predict; where they predict nothing, a gain beyond chance is enough."""
    left = DisturbanceRegression("fy", 0.9, {}, (), 100.0, None, 0.25)
    assert forward_backward._explains_enough(fit(0.0), fit(gained), left, 14.0) is enough
    assert forward_backward._explains_enough(fit(0.0), fit(gained), NOTHING_LEFT, 14.0) is (gained > 14.0)


@pytest.mark.parametrize(
    ("held", "pushed", "gains", "from_sizes"),
    [
        (("pose_latency",), True, 3.0, True),  # most of what is left has no name among the promising ones
        (("pose_latency",), True, 60.0, False), (("pose_latency",), False, 3.0, False), ((), True, 3.0, False),
    ],
)  # fmt: skip
def test_beside_what_was_found_all_others_are_tried_where_much_is_left(
    held: tuple[str, ...], pushed: bool, gains: float, from_sizes: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    best, first, found = fit(0.0, *held), fit(gains, *held, "motor_lag"), fit(80.0, *held, "rear_drag_asymmetry")
    monkeypatch.setattr(
        forward_backward,
        "rank_credible_fits",
        lambda fits, take: sorted(fits, key=lambda f: -f.penalised_log_likelihood),
    )
    monkeypatch.setattr(forward_backward.refits, "refit_from_large_sizes", lambda *_: [])
    monkeypatch.setattr(forward_backward, "effects_without_place", lambda fit, others: ("rear_drag_asymmetry",))
    monkeypatch.setattr(forward_backward, "refit_from_sizes", lambda fit, take, names, least: ([found], names))
    left, take = DisturbanceRegression("fx", 0.9, {}, (), 100.0, None, 0.25), SimpleNamespace(pushed=pushed)
    problem: Any = SimpleNamespace(take=take, excluded=("motor_lag",))
    state: Any = SimpleNamespace(best=best, from_sizes=(), nulls=SimpleNamespace(gate=14.0))
    fits, names = forward_backward._widen_refits(problem, state, [first], left, 14.0)
    assert fits == ([found, first] if from_sizes else [first])
    assert names == (("rear_drag_asymmetry",) if from_sizes else ())


def test_half_a_take_that_leads_astray_is_judged_by_the_whole(monkeypatch: pytest.MonkeyPatch) -> None:
    """What half a take makes of a poor explanation may not even drive the other half."""
    take = SimpleNamespace(segments=4, begin_s=np.array([0.0, 1.0, 2.0, 3.0]), T=12.0)
    stays = SimpleNamespace(phi=np.zeros(1), scales="of the whole")

    def on(fit: Any, take: Any, chosen: Any, phi: Any, scales: Any) -> Any:
        if scales == "of half" and 0 in chosen:
            raise PredictionDiverged("a prediction left the finite numbers")
        return np.full(len(chosen), -1.0 if scales == "of half" else -2.0)

    monkeypatch.setattr(held_out, "refit_on_half", lambda *_: SimpleNamespace(phi=np.ones(1), scales="of half"))
    monkeypatch.setattr(held_out, "_evaluate_segments", on)
    found = held_out.held_out_log_likelihoods(stays, take)  # type: ignore[arg-type]
    assert sorted(found) == [-2.0, -2.0, -1.0, -1.0]
    assert found[0] == -2.0


def test_a_trusted_simulation_s_figures_speak_on_every_block() -> None:
    take: Any = SimpleNamespace(begin_s=np.arange(0.0, 240.0, 1.5), T=240.0)
    scatter = np.random.default_rng(3).standard_normal(160)
    plain, bent = (held_out.bootstrap_gain(scatter, np.zeros(160), take, unbent) for unbent in (0.0, 50.0))
    assert bent.nats == pytest.approx(plain.nats + 50.0)
    assert np.subtract(bent.ci95, plain.ci95) == pytest.approx([50.0, 50.0])


def shoved(*sizes: float) -> Disturbances:
    """Pushes of these sizes along, across and about the car, as large as they may be expected."""
    push = np.random.default_rng(2).standard_normal((200, 3)) * sizes
    none = np.zeros(200)
    return Disturbances(
        none, none.astype(int), push, push / sizes, dict.fromkeys(STATE_NAMES, none), np.ones((200, 3)), push, push
    )


def test_what_acts_along_a_car_relieves_it_there() -> None:
    plain = shoved(1.0, 1.0, 1.0)
    assert push_reduction_shares(shoved(3.0, 1.0, 1.0), plain) == pytest.approx({"along": 1.0, "across": 0.0})
    assert push_reduction_shares(shoved(1.0, 2.0, 3.0), plain) == pytest.approx({"along": 0.0, "across": 1.0})
    both = push_reduction_shares(shoved(2.0, 2.0, 1.0), plain)
    assert both["along"] == pytest.approx(0.5, abs=0.1)
    assert push_reduction_shares(plain, plain) == {"along": 0.0, "across": 0.0}


@pytest.mark.parametrize(
    ("standing", "mixed"),
    [({"fx": 0.1, "fy": 0.8, "mz": 0.5}, ("yaw_scrub",)), ({"fx": 0.8, "fy": 0.1, "mz": 0.1}, ("motor_lag",)),
     ({"fx": 0.8, "fy": 0.8, "mz": 0.1}, ("motor_lag", "yaw_scrub"))],
)  # fmt: skip
def test_only_what_pushes_where_something_is_left_stands_in_for_it(
    standing: dict[str, float], mixed: tuple[str, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    seen = {"best": shoved(1.0, 1.0, 1.0), "no lag": shoved(3.0, 1.0, 1.0), "no scrub": shoved(1.0, 1.1, 3.0)}
    monkeypatch.setattr(proxies, "estimate_disturbances", lambda fit, take: seen[fit])
    left = DisturbanceRegression("fy", max(standing.values()), standing, (), 50.0, None, 0.25)
    shown: Any = proxies._Evidence(
        "best", {"motor_lag": "no lag", "yaw_scrub": "no scrub"}, RemainingMismatch(left, {}, ())
    )  # type: ignore[arg-type,dict-item]
    assert proxies._joint_proxies(shown, TAKE) == mixed


@pytest.mark.parametrize(
    ("pushed", "gain", "stands_in"),
    [(False, 300.0, True), (False, 700.0, False), (True, 300.0, False), (True, 250.0, True)],
)
def test_beside_pushes_an_effect_counts_as_what_it_gains(
    pushed: bool, gain: float, stands_in: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Free functions promise 200 nats of it to first order; of 280 in another channel 210 are left beside it."""
    monkeypatch.setattr(proxies, "channel_gains", lambda fit, take, place: {"fx": 200.0, "motor": 280.0})
    monkeypatch.setattr(
        proxies,
        "estimate_disturbances",
        lambda fit, take: shoved(1.0 if fit.penalised_log_likelihood else 3.0, 1.0, 1.0),
    )
    fits: Any = (
        SimpleNamespace(penalised_log_likelihood=gain),
        {"front_coulomb_friction": SimpleNamespace(penalised_log_likelihood=0.0)},
    )
    take: Any = SimpleNamespace(pushed=pushed)
    seen = proxies._Evidence(*fits, RemainingMismatch(NOTHING_LEFT, {"motor": 210.0}, ()))
    assert proxies._is_proxy("front_coulomb_friction", seen, take, None, seen.unexplained_channels(100.0)) is stands_in


@pytest.mark.parametrize(
    ("left", "explained", "stands_in"), [(160.0, 600.0, True), (140.0, 600.0, False), (160.0, 300.0, False)]
)
def test_a_name_leaves_little_of_what_it_explains(
    left: float, explained: float, stands_in: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of 1000 nats; or what is left in another channel was there without it as well."""
    monkeypatch.setattr(proxies, "channel_gains", lambda fit, take, place: {"fx": 1000.0, "motor": explained})
    monkeypatch.setattr(
        proxies,
        "estimate_disturbances",
        lambda fit, take: shoved(1.0 if fit.penalised_log_likelihood else 3.0, 1.0, 1.0),
    )
    fits: Any = (
        SimpleNamespace(penalised_log_likelihood=1000.0),
        {"front_coulomb_friction": SimpleNamespace(penalised_log_likelihood=0.0)},
    )
    take: Any = SimpleNamespace(pushed=False)
    seen = proxies._Evidence(*fits, RemainingMismatch(NOTHING_LEFT, {"motor": left}, ()))
    assert proxies._is_proxy("front_coulomb_friction", seen, take, None, seen.unexplained_channels(100.0)) is stands_in


@pytest.mark.parametrize(("gain", "stands_in"), [(400.0, True), (440.0, False)])
def test_half_as_much_may_be_left_beside_pushes_as_is_explained(
    gain: float, stands_in: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of 500 nats in the other channel 210 are left, or as many that trees predict."""
    monkeypatch.setattr(proxies, "channel_gains", lambda fit, take, place: {"fx": 200.0, "motor": 500.0})
    monkeypatch.setattr(
        proxies,
        "estimate_disturbances",
        lambda fit, take: shoved(1.0 if fit.penalised_log_likelihood else 3.0, 1.0, 1.0),
    )
    fits: Any = (
        SimpleNamespace(penalised_log_likelihood=gain),
        {"front_coulomb_friction": SimpleNamespace(penalised_log_likelihood=0.0)},
    )
    pushed: Any = SimpleNamespace(pushed=True)
    predicted = DisturbanceRegression("fx", 0.9, {"fx": 0.9}, (), 210.0, None, 0.25)
    for left, entering in ((NOTHING_LEFT, {"motor": 210.0}), (predicted, {})):
        found = proxies._select_proxies(
            proxies._Evidence(*fits, RemainingMismatch(left, entering, ())), pushed, None, 100.0
        )
        assert found == (("front_coulomb_friction",) if stands_in else ())


def fitted(of: Hypothesis, K_t: float, *values: float, penalised_log_likelihood: float = 0.0) -> Any:
    return SimpleNamespace(
        hypothesis=of,
        phi=of.phi_of(CAR._replace(K_t=K_t), values),
        scales=None,
        penalised_log_likelihood=penalised_log_likelihood,
    )


def test_beside_a_simulation_only_its_own_parameters_go_back(monkeypatch: pytest.MonkeyPatch) -> None:
    """The car is as the simulation knows it; raw commands' gain and all else as in each fit."""
    known = Hypothesis((), CAR, 2.012, Constants(), assumed=RAW_COMMANDS, raw_commands=True).trust_simulation(
        [0.0], 0.02
    )
    best = fitted(known.with_effects("slip_speed", "motor_lag", "yaw_scrub"), 300.0, 0.3, 0.5, 0.06, 13.0)
    no_lag = fitted(known.with_effects("slip_speed", "yaw_scrub"), 350.0, 0.1, 0.4, 14.0)
    no_scrub = fitted(known.with_effects("slip_speed", "motor_lag"), 250.0, 0.2, 0.6, 0.05)
    asked = dict[tuple[str, ...], tuple[float, dict[str, float]]]()

    def held(take: Any, of: Hypothesis, phi: np.ndarray, scales: Any) -> Any:
        asked[of.effects] = of.car(phi).K_t, of.effect_values(phi)
        if "yaw_scrub" not in of.effects:
            raise PredictionDiverged
        return SimpleNamespace(penalised_log_likelihood=0.0 if "motor_lag" in of.effects else -5000.0, car=lambda: CAR)

    monkeypatch.setattr(proxies, "evaluate_fixed", held)
    monkeypatch.setattr(proxies.RemainingMismatch, "beside", lambda *_: None)
    found: Any = SimpleNamespace(best=best, leave_one_out={"motor_lag": no_lag, "yaw_scrub": no_scrub})
    assert proxies._evaluate_beside_reference(found, TAKE, None).gains == {"motor_lag": 5000.0}
    for fit in (best, no_lag, no_scrub):
        K_t, values = asked[fit.hypothesis.effects]
        assert pytest.approx(CAR.K_t) == K_t
        assert values == pytest.approx(fit.hypothesis.effect_values(fit.phi))


@pytest.mark.parametrize(
    ("refitted", "beside", "trusted", "standing_in"),
    [
        (210.0, 210.0, False, ("front_coulomb_friction",)),
        (210.0, 210.0, True, ("front_coulomb_friction",)),
        (210.0, 20.0, True, ()),  # what is missing had bent a trusted simulation
        (20.0, 210.0, True, ()),
        (210.0, 20.0, False, ("front_coulomb_friction",)),  # of which there is none
    ],
)
def test_beside_a_trusted_simulation_an_effect_has_to_stand_in_twice(
    refitted: float, beside: float, trusted: bool, standing_in: tuple[str, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nats that are left in the motor beside an effect that gains as many, refitted and beside its own parameters."""
    known = Hypothesis((), CAR, 2.012, Constants())
    known = known.trust_simulation([], 0.02) if trusted else known
    best: Any = fitted(known.with_effects("front_coulomb_friction"), CAR.K_t, 9.0, penalised_log_likelihood=205.0)
    found: Any = SimpleNamespace(
        best=best, leave_one_out={"front_coulomb_friction": fitted(known, CAR.K_t)}, nulls=SimpleNamespace(gate=10.0)
    )
    held = proxies._Evidence(found.best, found.leave_one_out, RemainingMismatch(NOTHING_LEFT, {"motor": beside}, ()))
    monkeypatch.setattr(proxies, "_evaluate_beside_reference", lambda *_: held)
    monkeypatch.setattr(proxies, "channel_gains", lambda fit, take, place: {"fx": 200.0, "motor": 280.0})
    monkeypatch.setattr(
        proxies,
        "estimate_disturbances",
        lambda fit, take: shoved(1.0 if fit.penalised_log_likelihood else 3.0, 1.0, 1.0),
    )
    take: Any = SimpleNamespace(pushed=True)
    assert (
        proxies.find_proxies(found, take, None, RemainingMismatch(NOTHING_LEFT, {"motor": refitted}, ())) == standing_in
    )


@pytest.mark.parametrize(("field", "share", "there"), [("d_y", 1.0, False), ("d_y", 0.9, True), ("d_x", -1.0, False)])
def test_a_size_at_the_end_of_its_range_is_no_car_s(field: str, share: float, there: bool) -> None:
    """Tracked points do not lie beyond the car; a friction that falls to nothing is at its natural end."""
    hypothesis = Hypothesis((), CAR, 2.012, Constants()).with_effects("marker_offset", "tyre_soft_saturation")
    entries = {p.symbol: p for n in hypothesis.effects for p in hypothesis.entries[n].parameters}
    values = {"d_x": 0.0, "d_y": 0.0, "s": entries["s"].high} | {field: share * entries[field].high}
    phi = hypothesis.phi_of(CAR, [values[p.symbol] for _, p in hypothesis.effect_parameters])
    take = SimpleNamespace(length_s=[60.0])
    fit = SimpleNamespace(hypothesis=hypothesis, phi=phi)
    assert effects_at_bounds(fit, take) == (() if there else ("marker_offset",))  # type: ignore[arg-type]


@pytest.mark.parametrize(("t_s", "there"), [(1.0, False), (30.0, True), (590.0, False), (300.0, True)])
def test_a_change_at_an_end_of_the_take_is_none(t_s: float, there: bool) -> None:
    """Mass 'lost' in the first seconds is another car's for the rest: parameters bent past what is trusted of them."""
    hypothesis = Hypothesis((), CAR, 2.012, Constants()).with_effects("mass_change")
    fit = SimpleNamespace(hypothesis=hypothesis, phi=hypothesis.phi_of(CAR, [-0.2, t_s]))
    take = SimpleNamespace(length_s=[60.0] if t_s < 60.0 else [600.0, 300.0])
    assert effects_at_bounds(fit, take) == (() if there else ("mass_change",))  # type: ignore[arg-type]
