"""The benchmark: turns and ratios, peers that are the same car, and what it prints."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from cars import CAR

from bcid.bench import c_code, timing
from bcid.bench.car_in_arrays import NUMPY
from bcid.bench.equations import advance_period
from bcid.bench.rollouts import draw_commands
from bcid.bench.run import HOT_PATHS, summarise_timings
from bcid.bench.timing import PeerMissing, Skipped, TimedPeer, Timing, time_against_peers
from bcid.cli.app import main
from bcid.physics.car import advance_period as ours


def test_ratios_are_those_of_the_times(monkeypatch: pytest.MonkeyPatch) -> None:
    """By a clock of its own; the longest of a few turns, where the machine was busy, does not count."""
    now, turns = [0.0], [0]

    def lasting(seconds: float) -> Callable[[], None]:
        def work() -> None:
            turns[0] += 1
            now[0] += seconds * (50.0 if turns[0] == 12 else 1.0)

        return work

    def absent() -> Callable[[], None]:
        raise PeerMissing("no such library")

    monkeypatch.setattr(timing.time, "process_time", lambda: now[0])
    slower, alike = lasting(0.008), lasting(0.004)
    peers = {"slow": TimedPeer(lambda: slower, 1.2), "same": TimedPeer(lambda: alike, 10.0), "none": TimedPeer(absent)}
    skipped, slow, same = time_against_peers("a path", lasting(0.004), peers, 5, 3.9)
    assert skipped == Skipped("a path", "none", "no such library")
    assert isinstance(slow, Timing)
    assert isinstance(same, Timing)
    assert (slow.peer, same.peer) == ("slow", "same")
    assert (slow.ours_ms, slow.peer_ms, slow.ratio) == pytest.approx((4.0, 8.0, 2.0))
    assert same.ratio == pytest.approx(1.0)
    assert (slow.missed, same.missed) == (True, True)  # 4 ms are more than 3.9
    assert not replace(slow, longest_ms=4.1).missed


def test_a_peer_whose_results_are_others_misses() -> None:
    peers = {
        "near": TimedPeer(lambda: lambda: np.ones(3) + 1e-7, None, 1e-6),
        "far": TimedPeer(lambda: lambda: np.ones(2), None, 1e-6),
    }
    near, far = time_against_peers("a path", lambda: np.ones(3), peers, 1)
    assert isinstance(near, Timing)
    assert isinstance(far, Timing)
    assert (near.missed, near.difference) == (False, pytest.approx(1e-7))
    assert (far.missed, far.difference) == (True, np.inf)
    assert timing.largest_difference([1.0, np.nan], [np.nan, 1.0]) == np.inf


def test_without_a_compiler_c_is_skipped_and_why(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(c_code.shutil, "which", lambda name: None)
    rows = {r.peer: r for r in HOT_PATHS["newton-euler"](1)}
    skipped = rows["C by hand"]
    assert isinstance(skipped, Skipped)
    assert "no C compiler" in skipped.reason
    found = summarise_timings({"newton-euler": list(rows.values())}, 1, {"cores": 2})
    assert {"only": "newton-euler", "path": skipped.path, "peer": "C by hand", "reason": skipped.reason} in found[
        "skipped"
    ]


def test_c_that_does_not_compile_is_no_peer() -> None:
    with pytest.raises(PeerMissing):
        c_code.load_c("this is no C")


def test_the_peers_car_is_ours() -> None:
    """Written twice, the equations agree to the last digits."""
    state = mine = (1.0, 0.1, 0.2, 0.3)
    for u_s, u_m in draw_commands(400, 3):
        state = advance_period(state, u_s, u_m, CAR, 0.1, NUMPY)
        mine = ours(mine, u_s, u_m, CAR, 0.1)
        np.testing.assert_allclose(state, mine, rtol=0.0, atol=1e-11)


def test_what_is_missed_is_told_and_peers_that_are_absent_too() -> None:
    rows = [Timing("a path", "numpy", 2.0, 100.0, 40.0, 1e-15), Timing("a path", "other", 2.0, 100.0, 60.0, None)]
    found = summarise_timings({"fit": rows}, 5, {"cores": 2})
    assert [r["missed"] for r in found["rows"]] == [False, True]
    assert found["rows"][0]["ratio"] == 50.0
    assert found["schema"] == "bcid.bench/1"
    assert found["versions"]["numpy"] == np.__version__


@pytest.mark.parametrize("name", ["newton-euler", "newton-euler-many", "k-sindy", "filters"])
def test_a_path_can_be_timed(name: str) -> None:
    rows = [r for r in HOT_PATHS[name](1) if isinstance(r, Timing)]
    assert rows
    assert all(r.ours_ms > 0.0 and r.peer_ms > 0.0 for r in rows)
    assert all(r.difference is None or r.difference <= r.tolerated for r in rows)


def test_a_path_that_is_not_there_is_refused(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("sys.argv", ["bcid", "bench", "--only", "nothing"])
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 2
    assert "choose from newton-euler" in capsys.readouterr().err


def test_goals_missed_end_with_5_only_where_they_are_checked(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    from bcid.bench import run

    monkeypatch.setitem(
        run.HOT_PATHS, "newton-euler", lambda repeats: iter([Timing("a path", "peer", 2.0, 3.0, 60.0, None)])
    )
    for more, code in ([], 0), (["--check"], 5):
        monkeypatch.setattr(
            "sys.argv", ["bcid", "bench", "--only", "newton-euler", "--out", str(tmp_path / f"{code}.json"), *more]
        )
        with pytest.raises(SystemExit) as ended:
            main()
        assert ended.value.code == code
        assert "60 × missed" in capsys.readouterr().out
    assert '"missed": true' in (tmp_path / "5.json").read_text()


FIT = Timing("fit, an hour", "deap", 300.0, 9000.0, 20.0, None)
SLOW = Timing("rollout", "numpy", 2.0, 3.0, 60.0, None)
FAST = replace(SLOW, ours_ms=0.01)


def bench(monkeypatch: pytest.MonkeyPatch, *words: object) -> int:
    """The exit code of `bcid bench` with these words."""
    monkeypatch.setattr("sys.argv", ["bcid", "bench", *map(str, words)])
    with pytest.raises(SystemExit) as ended:
        main()
    return int(ended.value.code or 0)


@pytest.fixture
def timings(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """A file of one row of `newton-euler`, whose goal is missed, and one of `fit`."""
    from bcid.bench import run

    monkeypatch.setitem(run.HOT_PATHS, "newton-euler", lambda repeats: iter([SLOW]))
    monkeypatch.setitem(run.HOT_PATHS, "fit", lambda repeats: iter([FIT]))
    path = tmp_path / "bench.json"
    assert bench(monkeypatch, "--only", "fit", "--only", "newton-euler", "--out", path) == 0
    monkeypatch.setitem(
        run.HOT_PATHS, "newton-euler", lambda repeats: iter([FAST, Skipped("rollout", "jax", "absent")])
    )
    monkeypatch.setitem(run.HOT_PATHS, "fit", lambda repeats: pytest.fail("was timed"))
    return path


def test_some_rows_are_renewed_and_the_others_kept(monkeypatch: pytest.MonkeyPatch, timings: Path) -> None:
    before = json.loads(timings.read_text(encoding="utf-8"))
    assert before["missed"] == ["rollout against numpy"]
    assert bench(monkeypatch, "--only", "newton-euler", "--out", timings, "--renew") == 0
    after = json.loads(timings.read_text(encoding="utf-8"))
    fit = next(row for row in before["rows"] if row["only"] == "fit")
    assert after["rows"] == [{"only": "newton-euler"} | FAST.as_json(), fit]
    assert after["skipped"] == [{"only": "newton-euler", "path": "rollout", "peer": "jax", "reason": "absent"}]
    assert after["missed"] == []
    assert {key: after[key] for key in ("schema", "machine", "repeats")} == {
        key: before[key] for key in ("schema", "machine", "repeats")
    }


def edited(path: Path, key: str, value: object) -> None:
    data = json.loads(path.read_text(encoding="utf-8"))
    path.write_text(json.dumps(data | {key: value}), encoding="utf-8")


@pytest.mark.parametrize(
    ("key", "value", "said"),
    [
        ("machine", {"cores": 64}, "the machine was"),
        ("repeats", 3, "the number of turns"),
        ("versions", {"numpy": "1.0.0"}, "versions.numpy: was 1.0.0"),
        ("schema", "bcid.other/1", "no rows of bcid.bench/1"),
        ("rows", [{"path": "rollout"}], "no rows of bcid.bench/1"),
    ],
)
def test_rows_that_belong_in_no_table_are_refused(
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    timings: Path,
    key: str,
    value: object,
    said: str,
) -> None:
    edited(timings, key, value)
    before = timings.read_bytes()
    assert bench(monkeypatch, "--only", "newton-euler", "--out", timings, "--renew") == 4
    assert said in capsys.readouterr().err.replace("\n", " ")
    assert timings.read_bytes() == before


def test_a_library_that_no_renewed_row_used_keeps_its_version(monkeypatch: pytest.MonkeyPatch, timings: Path) -> None:
    monkeypatch.delitem(sys.modules, "deap", raising=False)
    edited(timings, "versions", {"numpy": np.__version__, "deap": "0.0.1"})
    assert bench(monkeypatch, "--only", "newton-euler", "--out", timings, "--renew") == 0
    assert json.loads(timings.read_text(encoding="utf-8"))["versions"]["deap"] == "0.0.1"


@pytest.mark.parametrize("words", [(), ("--only", "fit"), ("--out", "there.json"), ("accuracy", "--only", "fit")])
def test_renewing_needs_paths_and_a_file(monkeypatch: pytest.MonkeyPatch, words: tuple[str, ...]) -> None:
    assert bench(monkeypatch, *words, "--renew") == 2
