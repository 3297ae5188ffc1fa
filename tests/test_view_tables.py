"""Tables are read back equal from CSV, and are LaTeX that a compiler takes."""

from __future__ import annotations

import csv
import re
import shutil
import subprocess
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from typer.testing import CliRunner
from viewed import patch_found

from bcid.cli.app import app
from bcid.documents.diagnosis import DiagnosisDocument
from bcid.documents.error_budget import ErrorBudget, ErrorShare
from bcid.documents.report import LossScore, Machine, ModelScore, ReportDocument, Validation, Weights
from bcid.view.latex import escape_latex, format_symbol, table_as_latex
from bcid.view.tables import Between, Estimated, ResultTable, csv_cells, csv_header, diagnosis_tables, report_tables
from bcid.view.write_tables import write_tables

ROOT = Path(__file__).parent.parent
NASTY = "50 % of_a & b $ # { } ~ ^ \\ < > | ± τ m² s⁻¹ – … \n end"


def report() -> ReportDocument:
    """A comparison of a model that is good and one that diverges."""
    scores = (
        ModelScore(model="newton-euler", nmse=3.3e-4, nmse_ci95=(2.7e-4, 3.9e-4), nmse_vx=6e-4, parameters=10),
        ModelScore(model="narx_mlp & co", parameters=37379),
    )
    return ReportDocument(
        kind="bcid.report/1", vehicle="car",
        validation=Validation(name="last_take", duration_s=60.0, period_s=0.1, samples=600, segments=1),
        weights=Weights(v_x=1.0, v_y=1.0, yaw_rate=1.0), restart_s=2.0,
        machine=Machine(system="", processor="", cores=2, python=""), models=scores,
        losses=(LossScore(model="newton-euler", loss="rollout", nmse=3.3e-4),),
    )  # fmt: skip


def all_tables() -> list[ResultTable]:
    """Tables of a comparison and of diagnoses: a made one, and one of the committed results."""
    real = DiagnosisDocument.read(ROOT / "docs" / "results" / "diagnosis.json")
    tables = [*report_tables(report()), *diagnosis_tables(patch_found(1.8, -0.9)), *diagnosis_tables(real)]
    odd = ResultTable(
        "odd", NASTY, ("text", "number", "whole", "yes", "measured", "range"),
        (
            (NASTY, 1.5e-7, 3, True, Estimated(3.51e-5, 2e-6), Between(1.0, -0.5, 2.0)),
            ("", None, None, None, Estimated(2.0, None), Between(1.0, None, None)),
            ("x", -2.5, -1, False, Estimated(None, None), Between(None, None, None)),
        ),
        {"number": "m/s²"},
    )  # fmt: skip
    return [*(t for t in tables if t.rows), odd]


def columns_of(line: str) -> int:
    """How many columns a line of a LaTeX table fills."""
    cells = re.split(r"(?<!\\)&", line)
    return sum(int(m[1]) if (m := re.search(r"\\multicolumn\{(\d)\}", cell)) else 1 for cell in cells)


def test_what_an_error_is_made_of_is_a_table() -> None:
    parts = (
        ErrorShare(cause="effect", effects=("yaw_scrub", "rear_toe"), share=0.75, ci95=(0.7, 0.8)),
        ErrorShare(cause="unexplained", share=0.25, ci95=(-0.1, 0.3)),
    )
    found = DiagnosisDocument(verdict="named", error_budget=ErrorBudget(horizon_s=2.0, nmse=0.01, parts=parts))
    (table,) = [t for t in diagnosis_tables(found) if t.name == "budget"]
    assert csv_header(table) == ["cause", "effects", "share", "share low", "share high"]
    assert [csv_cells(row) for row in table.rows] == [
        ["effect", "yaw_scrub+rear_toe", "0.75", "0.7", "0.8"], ["unexplained", "", "0.25", "-0.1", "0.3"],
    ]  # fmt: skip
    assert "2 s ahead" in table.caption
    assert not [t for t in diagnosis_tables(DiagnosisDocument(verdict="unknown")) if t.rows]


@pytest.mark.parametrize("table", all_tables(), ids=lambda t: t.name)
def test_every_line_fills_the_columns_that_are_declared(table: ResultTable) -> None:
    text = table_as_latex(table)
    (declared,) = re.findall(r"\\begin\{tabular\}\{(.*)\}", text)
    n = len(re.sub(r"@\{[^l]*\}(?=l)", "", declared))
    lines = [line for line in text.splitlines() if line.endswith(r"\\")]
    assert len(lines) == 1 + len(table.rows)
    assert {columns_of(line) for line in lines} == {n}


@pytest.mark.parametrize("table", all_tables(), ids=lambda t: t.name)
def test_braces_and_formulas_are_closed(table: ResultTable) -> None:
    assert is_closed(table_as_latex(table))


def is_closed(text: str) -> bool:
    """Whether each brace and each formula that LaTeX text opens is closed in its line, and all text is escaped."""
    for line in text.splitlines():
        bare = re.sub(r"\\.", "", line.partition("% in the preamble")[0])
        depth = 0
        for c in bare:
            depth += (c == "{") - (c == "}")
            if depth < 0:
                return False
        outside = re.sub(r"\$[^$]*\$", "", bare)
        if depth or bare.count("$") % 2 or set("#%~$^_") & set(outside):
            return False
    return True


@given(st.text(alphabet=st.characters(codec="utf-8"), max_size=40))
def test_no_text_is_a_command(text: str) -> None:
    escaped = escape_latex(text)
    assert is_closed(escaped.replace("\n", " "))
    commands = set(re.findall(r"\\([a-zA-Z]+)", escaped))
    known = {"textbackslash", "textasciitilde", "textasciicircum", "textless", "textgreater", "textbar", "pm", "times",
             "cdot", "dots", "mu", "circ"}  # fmt: skip
    greek = {"alpha", "beta", "gamma", "delta", "varepsilon", "kappa", "rho", "sigma", "tau", "varphi", "psi", "omega",
             "Omega", "Delta"}  # fmt: skip
    assert commands <= known | greek
    assert not re.search(r"(?<!\\)&", escaped)


@pytest.mark.parametrize("symbol", ["C_f", "tau", "F_f_max", "x", "radius", "inverse_P", "a&b_c", "1/P", "T_s", "{_}"])
def test_symbols_are_formulas_or_escaped(symbol: str) -> None:
    assert is_closed(format_symbol(symbol))


def test_an_error_decides_the_digits() -> None:
    table = ResultTable(
        "t", "", ("symbol", "value"), (("C_f", Estimated(3594.0, 118.0)), ("b", Estimated(3.51e-5, 2e-6)))
    )
    text = table_as_latex(table)
    assert r"$C_{\mathrm{f}}$ & 3590 & 120 \\" in text
    assert r"$b$ & (3.5 & 0.2) $\times$ 10$^{-5}$ \\" in text
    assert r"\begin{tabular}{lr@{${}\pm{}$}l}" in text


def test_errors_are_told_in_thousandths_as_in_the_report() -> None:
    models, _ = report_tables(report())
    text = table_as_latex(models)
    assert r"\multicolumn{3}{c}{NMSE $\times 10^{3}$}" in text
    assert r"newton-euler & 0.33 & 0.27 & 0.39 & 0.60" in text
    assert r"narx mlp \& co & -- & \multicolumn{2}{c}{--}" in text


def parse(text: str, like: object) -> object:
    """A cell of a CSV file as a value of the kind of `like`."""
    if isinstance(like, bool):
        return text == "true"
    if isinstance(like, int | float):
        return type(like)(text)
    return text if like is not None else (text or None)


def test_csv_is_read_back_equal_to_the_last_digit(tmp_path: Path) -> None:
    tables = {t.name: t for t in all_tables()}
    written = write_tables(list(tables.values()), tmp_path, lambda there: False)
    assert len(written) == 2 * len(tables)
    for name, table in tables.items():
        with (tmp_path / f"{name}.csv").open(encoding="utf-8", newline="") as file:
            head, *rows = csv.reader(file)
        flat = [[p for c in row for p in (c if isinstance(c, Estimated | Between) else (c,))] for row in table.rows]
        assert len(rows) == len(flat)
        assert len(set(head)) == len(head) == len(flat[0])
        for row, known in zip(rows, flat, strict=True):
            assert [parse(text, value) for text, value in zip(row, known, strict=True)] == known


def test_the_command_writes_tables_of_what_is_there(tmp_path: Path) -> None:
    workspace = tmp_path / "workspace"
    (workspace / "report").mkdir(parents=True)
    report().write(workspace / "report" / "report.json")
    words = ["view", str(workspace), "--tables", str(tmp_path / "tables")]
    assert CliRunner().invoke(app, words).exit_code == 0
    assert {p.name for p in (tmp_path / "tables").iterdir()} == {"models.csv", "models.tex", "losses.csv", "losses.tex"}
    patch_found(1.8, -0.9).write(workspace / "diagnosis.json")
    again = CliRunner().invoke(app, words, standalone_mode=False)
    assert "exists already" in str(again.exception)
    assert CliRunner().invoke(app, [*words, "--force"]).exit_code == 0
    assert "30.4 & 0.2" in (tmp_path / "tables" / "findings.tex").read_text(encoding="utf-8")


def test_a_compiler_takes_the_tables(tmp_path: Path) -> None:
    engine = next((e for e in ("pdflatex", "xelatex", "lualatex", "tectonic") if shutil.which(e)), None)
    if engine is None:
        pytest.skip("no TeX engine is installed")
    body = "\n".join(map(table_as_latex, all_tables()))
    source = rf"\documentclass{{article}}\usepackage{{booktabs}}\begin{{document}}{body}\end{{document}}"
    (tmp_path / "tables.tex").write_text(source, encoding="utf-8")
    options = [] if engine == "tectonic" else ["-interaction=nonstopmode", "-halt-on-error"]
    done = subprocess.run([engine, *options, "tables.tex"], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout[-2000:]
