"""The figures in the docs are those of the committed JSON."""

from __future__ import annotations

import json
import re
import shlex
import subprocess
import sys
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import typer
from catalogue.table import catalogue_table, counts_told, faults_table, kills_told
from docs_tables import (
    bench_table,
    evidence_table,
    held_out_table,
    memory_table,
    methods_table,
    pushes_table,
    real_answers_table,
    real_figures_table,
    renew_bench_table,
)
from exported_models import MODELS
from measure_memory import ROWS

from bcid.aliases import Floats
from bcid.bench.limits import ACCURACY
from bcid.cli.app import app
from bcid.diagnosis.limits import DECIDING_LIMITS
from bcid.diagnosis.reference import read_parameter_file
from bcid.documents.prove import ProveDocument
from bcid.documents.varied_limits import VariedLimitsDocument
from bcid.effects.corrections import CORRECTIONS
from bcid.effects.table import ENTRIES
from bcid.likelihood.hypothesis import DRAG, MOTOR_LAWS, TYRES
from bcid.models.newton_euler.parameters import FORCE_UNITS, UNITS
from bcid.models.saving import save_model
from bcid.proof.blind.limit_panel import EXAMPLE_TIER
from bcid.report.formats import format_thousandths
from bcid.vehicle import Vehicle

ROOT = Path(__file__).parent.parent
DOCS = ROOT / "docs"
README_WORDS = 900
"""A door, and no proof."""
REAL_WORDS = 1500
"""On real recordings, beside the tables."""


def table(report: dict[str, object]) -> str:
    rows = [
        "| model | NMSE × 10³ | 95 % interval | v_x | v_y | yaw rate | rollout (ms) | parameters |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for m in report["models"]:  # type: ignore[attr-defined]
        low, high = m["nmse_ci95"]
        mean, v_x, v_y, yaw_rate = (f"{1e3 * m[k]:.2f}" for k in ("nmse", "nmse_vx", "nmse_vy", "nmse_yaw_rate"))
        interval = f"{1e3 * low:.2f} – {1e3 * high:.2f}"
        cells = [m["model"], mean, interval, v_x, v_y, yaw_rate, f"{m['rollout_ms']:.2f}", str(m["parameters"])]
        rows.append(f"| {' | '.join(cells)} |")
    return "\n".join(rows)


def losses(report: dict[str, object]) -> str:
    """Each model's NMSE × 10³ by either loss."""
    found: dict[str, dict[str, float]] = {}
    for m in report["losses"]:  # type: ignore[attr-defined]
        found.setdefault(m["model"], {})[m["loss"]] = 1e3 * m["nmse"]
    pairs = (f"{name} {v['one-step']:.2f} → {v['rollout']:.2f}" for name, v in found.items())
    return "; ".join(pairs) + "."


def accuracy_table(found: dict[str, object]) -> str:
    """NMSE × 10³ of our models and their peers, best at the end first."""
    rows = [
        "| data | model | 0.5 s | 2 s | 10 s | to the end | 95 % | seeds change |",
        "|---|---|---|---|---|---|---|---|",
    ]
    lines = found["table"]
    order = list(dict.fromkeys(t["data"] for t in lines))  # type: ignore[attr-defined]
    for line in sorted(lines, key=lambda t: (order.index(t["data"]), t["end"]["nmse"] or float("inf"))):  # type: ignore[call-overload]
        shown = [format_thousandths(line[h]["nmse"]) for h in ("0.5 s", "2 s", "10 s", "end")]
        interval = " – ".join(format_thousandths(v) for v in line["end"]["ci95"]) if line["end"]["ci95"] else "–"
        change = "–" if line["end"]["spread"] is None else f"{100 * line['end']['spread']:.0f} %"
        change += " **missed**" if line["ours"] and (line["end"]["spread"] or 0.0) > ACCURACY.max_seed_change else ""
        name = line["model"] if line["ours"] else f"*{line['model']}*"
        rows.append(f"| {' | '.join([line['data'], name, *shown, interval, change])} |")
    return "\n".join(rows)


def parameters_table(found: dict[str, object]) -> str:
    """How often a car's constants lie in the stated intervals, by what was minimised."""
    rows = ["| fitted on | constants stated | within 95 % | median error | bias, standard errors |"]
    rows.append("|---|---|---|---|---|")
    for r in found["rows"]:  # type: ignore[attr-defined]
        if r["symbol"] == "all":
            error, bias = f"{100 * r['median_error']:.2g} %", f"{r['bias_in_errors']:+.1f}"
            rows.append(f"| {r['loss']} | {r['n']} | {100 * r['covered']:.0f} % | {error} | {bias} |")
    return "\n".join(rows)


def predictions_table(found: dict[str, object]) -> str:
    """How often 95 % intervals of predictions hold, by car, model and horizon."""
    rows = [
        "| car | model | after | starts | pose | twist | both, its interval | least of a draw |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for r in found["rows"]:  # type: ignore[attr-defined]
        low, high = r["ci95"]
        model = f"{r['model']}, {r['loss']}" if r["loss"] else r["model"]
        shares = [f"{100 * r[key]:.0f} %" for key in ("pose", "twist", "covered")]
        shares[2] += f" ({100 * low:.0f} – {100 * high:.0f})"
        shares.append(f"{100 * min(r['draws']):.0f} %")
        after = f"{r['horizon_s']:g} s"
        rows.append(f"| {' | '.join([r['car'], model, after, str(r['starts']), *shares])} |")
    return "\n".join(rows)


def test_what_the_docs_say_of_bad_recordings_is_what_is_said() -> None:
    golden = json.loads((ROOT / "tests" / "catalogue" / "golden.json").read_text(encoding="utf-8"))
    assert catalogue_table(golden) in (DOCS / "recordings.md").read_text(encoding="utf-8")


def test_the_docs_counts_of_faults_are_the_committed_ones() -> None:
    found = json.loads((DOCS / "results" / "faults.json").read_text(encoding="utf-8"))
    text = (DOCS / "recordings.md").read_text(encoding="utf-8")
    for told in (faults_table(found["fuzz"]), kills_told(found["kills"]), counts_told(found)):
        assert told in text


def test_the_docs_accuracies_are_the_committed_comparison() -> None:
    found = json.loads((DOCS / "results" / "accuracy.json").read_text(encoding="utf-8"))
    assert accuracy_table(found) in (DOCS / "accuracy.md").read_text(encoding="utf-8")


def test_the_docs_constants_are_the_committed_recovery() -> None:
    found = json.loads((DOCS / "results" / "parameters.json").read_text(encoding="utf-8"))
    text = (DOCS / "accuracy.md").read_text(encoding="utf-8")
    assert parameters_table(found) in text
    assert f"{found['fits']} takes of {found['seconds']:g} s" in text


def test_the_docs_coverage_of_predictions_is_the_committed_one() -> None:
    found = json.loads((DOCS / "results" / "predictions.json").read_text(encoding="utf-8"))
    assert predictions_table(found) in (DOCS / "python.md").read_text(encoding="utf-8")


def test_the_docs_speeds_are_the_committed_benchmark() -> None:
    bench = json.loads((DOCS / "results" / "bench.json").read_text(encoding="utf-8"))
    text = (DOCS / "speed.md").read_text(encoding="utf-8")
    assert bench_table(bench) in text
    assert renew_bench_table(text, bench) == text


def test_a_table_of_speeds_is_renewed_in_its_place() -> None:
    text = (DOCS / "speed.md").read_text(encoding="utf-8")
    bench = json.loads((DOCS / "results" / "bench.json").read_text(encoding="utf-8"))
    fewer = bench | {"rows": bench["rows"][:2]}
    renewed = renew_bench_table(text + "\nAfterwards.\n", fewer)
    assert renewed.endswith("\n\nAfterwards.\n")
    assert bench_table(fewer) in renewed
    assert renewed.count("\n") == text.count("\n") + 2 - len(bench["rows"]) + 2


def test_the_docs_losses_are_the_committed_report() -> None:
    report = json.loads((DOCS / "results" / "report.json").read_text(encoding="utf-8"))
    assert losses(report) in (DOCS / "accuracy.md").read_text(encoding="utf-8")


def test_the_docs_table_is_the_committed_report() -> None:
    report = json.loads((DOCS / "results" / "report.json").read_text())
    assert table(report) in (DOCS / "accuracy.md").read_text(encoding="utf-8")


def test_the_readme_s_sentence_is_the_committed_diagnosis() -> None:
    from bcid.documents.diagnosis import DiagnosisDocument
    from bcid.report.verdict_words import verdict_sentence

    diagnosis = DiagnosisDocument.read(DOCS / "results" / "diagnosis.json")
    assert f"> {verdict_sentence(diagnosis)}\n" in (ROOT / "README.md").read_text(encoding="utf-8")


def test_the_main_job_finds_what_the_readme_says() -> None:
    """Figures of another machine may differ by their standard error; names may not differ, of the last job run here."""
    from bcid.documents.diagnosis import DiagnosisDocument

    made = ROOT / "workspace" / "diagnosis" / "diagnosis.json"
    if not made.is_file():
        pytest.skip("the main job has not been run here: `make run` does it")
    found, told = (DiagnosisDocument.read(p) for p in (made, DOCS / "results" / "diagnosis.json"))
    assert [f.effect for f in found.findings] == [f.effect for f in told.findings]
    for one, other in zip(found.findings, told.findings, strict=True):
        assert one.parameters.keys() == other.parameters.keys()
        for symbol, known in other.parameters.items():
            assert one.parameters[symbol].value == pytest.approx(known.value, abs=known.se), symbol


def test_the_docs_evidence_is_the_committed_blind_test() -> None:
    whole, quick = (ProveDocument.read(DOCS / "results" / f"{name}.json") for name in ("prove", "prove_quick"))
    readme = (DOCS / "evidence.md").read_text(encoding="utf-8")
    assert evidence_table(whole) in readme
    assert methods_table(quick) in readme
    assert f"seed {quick.seed}, code {quick.code}" in readme
    stated = whole.calibration.bins[-1]
    assert f"of {stated.n} names with that much {round(stated.n * stated.there)} were there" in readme
    right, wanted = quick.pooled.right, quick.pooled.expected
    assert f"{right} of {quick.pooled.n} right where {wanted:.1f} are wanted" in readme


def map_numbers(data: Any, change: Callable[[float], Any]) -> Any:
    """Nested JSON data with each of its numbers with a fraction changed."""
    if isinstance(data, dict):
        return {key: map_numbers(value, change) for key, value in data.items()}
    if isinstance(data, list):
        return [map_numbers(value, change) for value in data]
    return change(data) if isinstance(data, float) else data


def to_ten_digits(data: Any) -> Any:
    """Nested JSON data with its numbers to ten digits: from Python 3.12 on a sum is rounded once, at its end."""
    return map_numbers(data, lambda number: float(f"{number:.10g}"))


def numbers_apart(data: Any) -> tuple[Any, list[float]]:
    """Nested JSON data with None for each number with a fraction, and these numbers in their order."""
    numbers = list[float]()
    return map_numbers(data, numbers.append), numbers


def test_the_blind_test_s_figures_follow_from_its_rows() -> None:
    """And its seals hold the answers of its seed, which are those of any machine to the last digits but some."""
    from bcid.proof.blind.blind_test import BlindTest, SuiteSizes
    from bcid.proof.blind.run_cases import case_truth
    from bcid.proof.blind.seal import ANSWERS_FILE, SEALS_FILE, case_answer, seal_of, seal_over
    from bcid.proof.rows import read_rows
    from bcid.proof.scores.outcome import blind_outcome

    results = DOCS / "results"
    folder = results / "proof"
    told = json.loads((results / "prove.json").read_text(encoding="utf-8"))
    seals = json.loads((folder / SEALS_FILE).read_text(encoding="utf-8"))
    cases = BlindTest(told["seed"], told["salt"], sizes=SuiteSizes.of_stored_run(told["sizes"])).cases
    opened = {a["case"]: a for a in json.loads((folder / ANSWERS_FILE).read_text(encoding="utf-8"))["answers"]}
    assert {name: seal_of(answer, told["salt"]) for name, answer in opened.items()}.items() <= seals["cases"].items()
    drawn = {case.name: json.loads(json.dumps(case_answer(case))) for case in cases}
    for name, answer in opened.items():
        # sealed before a further lag counted as there in cars of other formulas, whose servos are of second order
        if "also" in drawn[name]:
            drawn[name]["also"] = {e: v for e, v in drawn[name]["also"].items() if v or e in answer["also"]}
        # of cars of other formulas some are fitted, which ends where the processor lets it
        (words, numbers), (said, told_numbers) = numbers_apart(drawn[name]), numbers_apart(answer)
        assert words == said
        assert numbers == pytest.approx(told_numbers, rel=1e-4), name
    assert list(drawn) == list(seals["cases"])
    assert seal_over(seals["cases"].values()) == seals["seal"] == told["seal"]
    rows = {row.get("case", key.partition(".")[0]): row for key, row in read_rows(folder).items()}
    assert {key.partition(".")[2] for key in read_rows(folder)} == {told["code"]}
    text = (DOCS / "evidence.md").read_text(encoding="utf-8")
    assert f"seed {told['seed']}, code {told['code']}" in text
    assert f"{told['pooled']['right']} of {told['cases']} takes were answered right" in text
    # rows of older runs have no name of their case
    found = [(case, rows.get(case.name) or rows.get(case.digest())) for case in cases]
    ran = [case_truth(case) | {"also": list(opened[case.name].get("also", ()))} | row for case, row in found if row]
    if len(ran) < len(rows):
        pytest.skip(f"{len(rows) - len(ran)} takes are drawn otherwise in their last digits on this processor")
    about = {key: told[key] for key in ("seed", "salt", "quick", "sizes", "of", "tiers_of", "seal", "code")}
    again = json.loads(json.dumps(blind_outcome(ran, about).as_json()))
    for key in ("cases", "tiers", "pooled_by_tier", "calibration", "p_values", "confusion", "missed"):
        assert to_ten_digits(again[key]) == to_ten_digits(told[key]), key
    # in the order in which takes ended
    assert again["pooled"] == pytest.approx(told["pooled"])
    assert sorted(again["wrong"], key=str) == sorted(told["wrong"], key=str)


def test_the_docs_count_of_verdicts_that_hang_on_a_limit_is_the_committed_one() -> None:
    varied = VariedLimitsDocument.read(DOCS / "results" / "limits.json")
    verdicts = sum(2 * limit.takes for limit in varied.limits)
    worst = max(limit.changed_share or 0.0 for limit in varied.limits)
    assert not varied.missed
    assert not any(change.case.startswith(EXAMPLE_TIER) for change in varied.changes)
    said = f"{len(varied.changes)} of {verdicts} verdicts"
    assert f"{said} changed, at most {100.0 * worst:.2f} %" in (DOCS / "evidence.md").read_text(encoding="utf-8")
    method = (DOCS / "method.md").read_text(encoding="utf-8")
    assert f"Of {verdicts} (seed {varied.seed}" in method
    assert {limit.limit for limit in varied.limits} == set(DECIDING_LIMITS)


def real_answers() -> list[dict[str, Any]]:
    """The committed outcomes of questions to real recordings that have an answer."""
    files = sorted((DOCS / "results").glob("real_*.json"))
    answers = [json.loads(file.read_text(encoding="utf-8")) for file in files]
    return [answer for answer in answers if answer.get("schema") == "bcid.prove-real/2"]


def test_the_docs_tables_of_real_recordings_are_those_of_the_committed_rows() -> None:
    """Of questions that have an answer: figures are counted anew from the rows."""
    found = real_answers()
    assert len(found) == 2
    page = (DOCS / "real_recordings.md").read_text(encoding="utf-8")
    rows = [row for outcome in found for row in outcome["rows"]]
    assert real_figures_table(rows) in page
    assert real_answers_table(rows) in page
    told = " ".join((DOCS / "evidence.md").read_text(encoding="utf-8").split())
    for tier, words in (
        ("withheld", "withheld effects are named"),
        ("control", "controls pass"),
        ("edited", "edits are"),
    ):
        of_tier = [row for row in rows if row["tier"] == tier]
        assert f"{sum(bool(row['right']) for row in of_tier)} of {len(of_tier)} {words}" in told
    assert all(outcome["code"] in page for outcome in found)


def test_the_docs_tell_how_many_edits_of_each_drive_are_found() -> None:
    found = json.loads((DOCS / "results" / "real_dart.json").read_text(encoding="utf-8"))
    page = (DOCS / "real_recordings.md").read_text(encoding="utf-8")
    for drive in ("10_01_01", "09_50_18"):
        right = [row["right"] for row in found["rows"] if drive in row["recording"] and row["tier"] == "edited"]
        assert f"{sum(right)} of {len(right)} on {drive}" in page


def test_the_docs_of_fleets_tell_what_a_cluster_made() -> None:
    found = json.loads((DOCS / "results" / "fleet_cluster.json").read_text(encoding="utf-8"))
    page = (DOCS / "fleet.md").read_text(encoding="utf-8")
    assert found["differ"] == []
    assert found["cluster"]["killed"] == 1.0
    assert found["done"] == found["logs"]
    assert f"{found['logs']} logs of half a minute, taken through everything" in page
    assert found["seconds"] == 30.0
    cost = found["local"]
    few, many = cost["few"], cost["many"]
    assert f"Among {many['logs']} a log takes {cost['growth']:.2f} times the processor time" in page
    assert f"takes among {few['logs']}, and the largest process {many['peak_mib']:.0f} MiB in place of" in page
    assert f"MiB in place of {few['peak_mib']:.0f}" in page
    assert f"gave the same {found['files']} files" in page
    assert f"which {found['differ_by_the_command']} of them tell" in page


def test_the_readme_is_a_door() -> None:
    assert len((ROOT / "README.md").read_text(encoding="utf-8").split()) <= README_WORDS


def test_the_readme_s_trust_is_what_was_counted() -> None:
    readme = " ".join((ROOT / "README.md").read_text(encoding="utf-8").split())
    proof = ProveDocument.read(DOCS / "results" / "prove.json")
    assert f"{proof.pooled.right} of {proof.pooled.n} takes are answered rightly" in readme
    of_nothing = [t for t in proof.tiers if t.tier in ("null", "null-imperfect")]
    named = sum(round((t.false or 0.0) * t.n) for t in of_nothing)
    assert f"{named} of {sum(t.n for t in of_nothing)} get a name" in readme
    parameters = json.loads((DOCS / "results" / "parameters.json").read_text(encoding="utf-8"))
    (poses,) = [r for r in parameters["rows"] if r["symbol"] == "all" and r["loss"] == "poses"]
    assert f"in {100 * poses['covered']:.0f} % of {poses['n']} cases" in readme
    asked = [row for answer in real_answers() for row in answer["rows"]]
    for tier, words in (
        ("withheld", "withheld effects are named"),
        ("edited", "edits found"),
        ("control", "controls pass"),
    ):
        of_tier = [row for row in asked if row["tier"] == tier]
        assert f"{sum(bool(row['right']) for row in of_tier)} of {len(of_tier)} {words}" in readme


def times_the_former(swaps: list[dict[str, Any]], name: str) -> Floats:
    """How many times its former error each swap has from 20 s after the change on, which comes at 120 s."""
    ratios = []
    for swap in swaps:
        since, errors = np.array(swap["begin_s"]) - 120.0, np.array(swap[name]["errors_m"])
        after, before = (errors[rows] for rows in (since >= 20.0, (since >= 5.0 - 120.0) & (since < -2.0)))
        ratios.append(np.sqrt(np.mean(after**2) / np.mean(before**2)))
    return np.array(ratios)


def test_the_docs_of_adapting_and_pooling_are_what_was_measured() -> None:
    measured = json.loads((DOCS / "results" / "adaptation.json").read_text(encoding="utf-8"))
    figures, swaps = measured["figures"], measured["swaps"]
    text = (DOCS / "adaptation.md").read_text(encoding="utf-8")
    alone, both = figures["mass"], figures["mass+F_r_max"]
    for errors in (figures["frozen_m"], alone["errors_m"], both["errors_m"]):
        assert " | ".join(f"{100 * x:.1f}" for x in errors) in text
    assert f"| – | {100 * figures['refitted_m']:.1f} |" in text
    assert f"in {figures['swaps']} drives" in text
    assert alone["reaches_the_goal"]
    assert both["reaches_the_goal"]
    for said, (a, b, c) in (
        ("{:.2f} times after 10 – 20 s, {:.2f} and {:.2f} later", alone["times_the_former"][3:]),
        ("it is {:.2f}, then {:.2f} and {:.2f}", both["times_the_former"][3:]),
    ):
        assert said.format(a, b, c) in text
    right, right_both = (f["share_of_moments_with_right_mass"] for f in (alone, both))
    single, single_both = (times_the_former(swaps, name) for name in ("mass", "mass+F_r_max"))
    said = (
        f"{np.sum(single <= 1.2)} of {len(swaps)} reach it with `mass` alone (the worst has {single.max():.2f} times)"
    )
    assert f"taken one by one {said}, as many with both" in text
    assert np.sum(single_both <= 1.2) == np.sum(single <= 1.2)
    within = f"{100 * alone['share_within_two_sd']['median']:.1f} %"
    assert f"two of its standard deviations in {within}" in text
    assert f"{100 * alone['errors_m'][0]:.1f} against {100 * figures['frozen_m'][0]:.1f} cm" in text
    said = "in {:.1%} of the moments of the median drive ({:.1%} in the worst); with `F_r_max` in {:.1%} ({:.1%})"
    shares = (right["median"], right["least"], right_both["median"], right_both["least"])
    assert said.format(*shares).replace("%", " %") in text
    first = alone["first_right_s"]
    assert f"first after {first['median']:.1f} s (median; {first['largest']:.1f} s at most)" in text
    assert f"from second {alone['right_to_the_end_from_s']['median']:.0f} on in the median drive" in text
    assert f"{both['slowest_real_time_factor']:,.0f} times as fast" in text
    pooled = json.loads((DOCS / "results" / "pooling.json").read_text(encoding="utf-8"))["figures"]
    text = (DOCS / "pooling.md").read_text(encoding="utf-8")
    assert f"all {pooled['loads']} loads are within 3 %" in text
    assert pooled["within_3_percent"] == pooled["loads"]
    assert f"off by {100 * pooled['median_error_pooled_m']:.2f} cm with the pooled car" in text
    assert f"by {100 * pooled['median_error_alone_m']:.2f} cm with the cars fitted to one empty drive" in text
    assert f"than {pooled['pooled_better_than_each_alone']} of the {pooled['alone']} single cars" in text
    assert pooled["pooled_better_than_mean_alone"] == pooled["fleets"]


PAGES_OF_COMMANDS = [
    page.relative_to(ROOT).as_posix() for page in (ROOT / "README.md", *sorted(DOCS.glob("*.md")))
    if "```sh\n" in page.read_text(encoding="utf-8")
]  # fmt: skip


def blocks(page: str, language: str) -> list[str]:
    """The blocks of code in a `language` of a page of the docs."""
    return re.findall(
        rf"^```{language}\n(.*?)^```$", (ROOT / page).read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL
    )


def command_lines(page: str) -> list[str]:
    """What a page says to type that begins with `bcid`, or with where that lies."""
    lines = [line.strip() for block in blocks(page, "sh") for line in block.splitlines()]
    return [line for line in lines if re.match(r"(\S*/)?bcid\s", line)]


@pytest.mark.parametrize("page", PAGES_OF_COMMANDS)
def test_every_command_line_of_the_docs_is_one_that_is_accepted(
    page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    lines = command_lines(page)
    assert lines
    for line in lines:
        parse_command(line)


def parse_command(line: str) -> None:
    """Raise what the command line raises for `line`: a command, option or value that there is not.

    Values are those that the shell would complete, in a folder without files.
    """
    _, name, *words = shlex.split(line, comments=True)
    group: Any = typer.main.get_command(app)
    assert name in group.commands, f"no such command: {line}"
    context = group.commands[name].make_context(name, words)
    own = any(isinstance(value, Path) for option, value in context.params.items() if "effects" in option)
    for parameter in group.commands[name].params:
        given, known = context.params.get(parameter.name), parameter.shell_complete(context, "")
        for value in given if isinstance(given, list | tuple) else [given]:
            if known and isinstance(value, str) and not own:
                assert value in {item.value for item in known}, f"no such {parameter.name}: {value}"


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("bcid sail away", "no such command"), ("bcid export MODEL --format c --wings", "No such option: --wings"),
        ("bcid export MODEL --output loud", "'loud' is not one of"), ("bcid export", "Missing"),
        ("bcid export MODEL --format cassadi", "no such format: cassadi"),
        ("bcid plan wind --vehicle v.toml", "no such effects: wind"),
        ("bcid fit take.csv --model newton", "no such model: newton"),
    ],
)  # fmt: skip
def test_a_command_line_that_is_not_accepted_would_be_found(
    line: str, said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(Exception, match=said):
        parse_command(line)


def test_the_python_of_the_quickstart_runs(tmp_path: Path) -> None:
    (snippet,) = blocks("docs/quickstart.md", "python")
    (named,) = re.findall(r'bcid\.load\("([^"]+)"\)', snippet)
    (tmp_path / named).mkdir(parents=True)
    save_model(MODELS["newton-euler-augmented"], tmp_path / named)
    program = tmp_path / "snippet.py"
    told = "print(car.twist.shape, prediction.pose.shape)"
    program.write_text(f"{snippet}{told}\n", encoding="utf-8")
    done = subprocess.run([sys.executable, program.name], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == ["(3,)", "(51,", "3)"]


def test_every_link_of_the_docs_leads_somewhere() -> None:
    for page in (ROOT / "README.md", ROOT / "CONTRIBUTING.md", *DOCS.glob("*.md")):
        for link in re.findall(r"\]\(([^)#]+)(?:#[^)]*)?\)", page.read_text(encoding="utf-8")):
            assert link.startswith("https://") or (page.parent / link).exists(), (page.name, link)


def test_the_docs_tell_how_far_models_of_a_real_drive_hold() -> None:
    found = json.loads((DOCS / "results" / "real_extrapolation.json").read_text(encoding="utf-8"))
    page = " ".join((DOCS / "real_recordings.md").read_text(encoding="utf-8").split())
    slow, fast = found["drives"]
    (low, _, high), (_, _, across) = found["drives"][slow].values()
    assert f"{low:.1f} m/s, {high:.1f} at most, with up to {across:.1f} m/s² across" in page
    known, published = (found["models"][name] for name in ("fitted beside the published", "published"))
    errors = [[model[f"on {drive}"]["median_m"] for model in (known, published)] for drive in (fast, slow)]
    assert "off by {:.2f} m, the published simulation by {:.2f} m".format(*errors[0]) in page
    assert "({:.2f} against {:.2f} m)".format(*errors[1]) in page
    held = found["models"]["tyres and inertia held, beside a remainder"][f"on {fast}"]["median_m"]
    assert f"is off by {held:.2f} m on the fast drive" in page
    free = found["models"]["fitted freely"][f"on {fast}"]["median_m"]
    text = (DOCS / "real_recordings.md").read_text(encoding="utf-8").partition("## Every answer")[0]
    assert sum(len(line.split()) for line in text.splitlines() if not line.startswith("|")) <= REAL_WORDS
    assert f"Fitted freely the car is off by {free:.2f} m" in page
    by = found["log_likelihood"]["tyres and inertia held"] - found["log_likelihood"]["fitted beside the published"]
    assert f"the likelihood is {by:.0f} nats higher" in page
    one, other = found["remainders"]
    assert f"tyres {other['alone'] - one['alone']:.0f} nats apart" in page
    assert f"evidence is {other['with_remainder'] - one['with_remainder']:.0f} nats apart" in page


def test_the_docs_tell_what_is_wrong_with_base_models_of_real_drives() -> None:
    found = json.loads((DOCS / "results" / "real_misfits.json").read_text(encoding="utf-8"))
    page = " ".join((DOCS / "real_recordings.md").read_text(encoding="utf-8").split())
    free, held = (found["inertia"][key] for key in ("free", "held"))
    assert free["constants"]["I_z"] > 12.0 * held["constants"]["I_z"]
    assert f"the drive is {free['log_likelihood'] - held['log_likelihood']:.0f} nats likelier" in page
    worst = max(abs(row["off"] / row["yaw_rate"]) for row in found["inertia"]["yaw_rate_of_held"])
    assert f"are off by up to {100.0 * worst:.0f} %" in page
    published = tomllib.loads((ROOT / "pipelines" / "dart" / "simulation.toml").read_text(encoding="utf-8"))[
        "parameters"
    ]["K_t"]
    taken = found["together"]["without_offset"]["constants"]["K_t"] / published
    assert f"together take {100.0 * taken:.0f} % of the published motor force" in page
    offset = found["together"]["offset"]
    assert f"by {offset['rad']:.4f} ± {offset['se']:.4f} rad, worth {offset['nats']:.0f} nats together" in page
    slow, fast = found["alike"].values()
    lean, play = ([law[key] for law in (slow, fast)] for key in ("lean_m_per_mps2", "play_rad"))
    assert all(law["size"] < 0.0 for law in (*lean, *play))
    leans = " and ".join(f"{-1e3 * law['size']:.2f} ± {1e3 * law['se']:.2f}" for law in lean)
    assert f"leans outward by {leans} mm" in page
    plays = " and ".join(f"{-law['size']:.4f} ± {law['se']:.4f}" for law in play)
    assert f"fall short of their angle by {plays} rad" in page


def test_the_docs_tell_what_free_functions_predict_of_real_drives() -> None:
    drives = json.loads((DOCS / "results" / "real_held_out.json").read_text(encoding="utf-8"))["drives"]
    page = (DOCS / "real_recordings.md").read_text(encoding="utf-8")
    assert held_out_table(drives) in page
    helped = [d for d in drives.values() if d["function_share"] > 0.0]
    assert all(d["errors"]["2"]["remainder"] < d["errors"]["2"]["after"] for d in helped)
    assert f"On {len(helped)} of {len(drives)} drives" in page


def test_the_docs_tell_how_far_the_last_sealed_run_came() -> None:
    proof = ProveDocument.read(DOCS / "results" / "prove_sealed.json")
    before = ProveDocument.read(DOCS / "results" / "prove_two_hours.json")
    text = " ".join((DOCS / "evidence.md").read_text(encoding="utf-8").split())
    assert f"{proof.pooled.right} are answered rightly, where {proof.pooled.expected:.1f} are wanted" in text
    assert f"got through {proof.pooled.n} of its {proof.of} takes" in text
    assert f"seed {proof.seed}" in text
    right = {t.tier: (round((t.right or 0.0) * t.n), t.n) for t in proof.tiers}
    nothing = [right[tier] for tier in ("null", "null-imperfect", "small-null")]
    one = [right[tier] for tier in ("single", "single-imperfect", "small-exact", "small-plus") if tier in right]
    for tiers, words in ((nothing, "all {} cars without an effect"), (one, "all {} of one effect")):
        assert all(r == n for r, n in tiers)
        assert words.format(sum(n for _, n in tiers)) in text
    assert (right["outside"], right["left-out"]) == ((1, 3), (1, 2))
    assert "other-laws-less" not in right
    assert f"{before.pooled.right} of {before.pooled.n} right" in text
    assert [t.right for t in before.tiers if t.tier == "other-laws-less" and t.n == 4] == [0.0]


def test_the_docs_tell_what_memory_large_recordings_take() -> None:
    rows = json.loads((DOCS / "results" / "memory.json").read_text(encoding="utf-8"))["rows"]
    assert {(row["kind"], row["command"]) for row in rows} == {(kind, command) for kind, _, _, command in ROWS}
    assert memory_table(rows) in (DOCS / "formats.md").read_text(encoding="utf-8")
    # a gibibyte; the pose of one car is all that is held
    assert max(row["peak_mib"] for row in rows) < 1024


def test_the_docs_tell_what_the_law_of_pushes_decides() -> None:
    laws = json.loads((DOCS / "results" / "pushes.json").read_text(encoding="utf-8"))
    assert pushes_table(laws) in (DOCS / "method.md").read_text(encoding="utf-8")


def test_the_docs_are_text_without_control_characters() -> None:
    for path in DOCS.glob("*.md"):
        text = path.read_text(encoding="utf-8")
        assert all(sign.isprintable() or sign in "\n\xa0" for sign in text), path.name


def test_the_page_of_effects_is_what_the_command_makes() -> None:
    from bcid.effects.listing import effects_page
    from bcid.effects.table import EFFECTS

    page = (DOCS / "effects.md").read_text(encoding="utf-8")
    assert page == effects_page(list(EFFECTS.values())) + "\n"
    for effect in EFFECTS.values():
        assert f"`{effect.id}`" in page


def test_the_docs_of_the_vehicle_file_have_every_key_and_table() -> None:
    text = (DOCS / "vehicle.md").read_text(encoding="utf-8")
    for table, field in Vehicle.model_fields.items():
        if table == "name":
            continue
        assert f"`[{table}]`" in text
        if table not in ("topics", "columns", "commands"):  # formats.md has these
            assert field.annotation is not None
            missing = [key for key in field.annotation.model_fields if f"`{key}`" not in text]
            assert not missing, f"[{table}]: {missing}"


def test_the_docs_of_the_base_model_have_every_constant_and_correction_and_a_simulation_that_is_read(
    tmp_path: Path,
) -> None:
    text = (DOCS / "model.md").read_text(encoding="utf-8")
    missing = [symbol for symbol in (UNITS | FORCE_UNITS) if f"`{symbol}`" not in text]
    assert not missing
    told = re.findall(r"^\| `(\w+)` \|", text.partition("## Its own simplifications")[2], re.MULTILINE)
    assert set(told) == set(CORRECTIONS)
    (simulation,) = blocks("docs/model.md", "toml")
    file = tmp_path / "simulation.toml"
    file.write_text(simulation, encoding="utf-8")
    read = read_parameter_file(file)
    assert set(read.parameters) == {*MOTOR_LAWS["force"], *TYRES, *DRAG}
    assert set(read.effects) <= set(ENTRIES)
    assert set(read.relative_sd_of) <= set(read.parameters)
