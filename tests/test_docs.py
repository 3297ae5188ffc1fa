"""The figures in the docs are those of the committed JSON."""

from __future__ import annotations

import json
from pathlib import Path

ROOT = Path(__file__).parent.parent


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


def test_the_readme_s_table_is_the_committed_report() -> None:
    report = json.loads((ROOT / "docs" / "results" / "report.json").read_text())
    assert table(report) in (ROOT / "README.md").read_text(encoding="utf-8")


def test_the_readme_s_sentence_is_the_committed_diagnosis() -> None:
    from bcid.report.diagnosis_page import verdict_sentence

    diagnosis = json.loads((ROOT / "docs" / "results" / "diagnosis.json").read_text(encoding="utf-8"))
    assert f"> {verdict_sentence(diagnosis)}\n" in (ROOT / "README.md").read_text(encoding="utf-8")


def test_the_readme_s_evidence_is_the_committed_blind_test() -> None:
    from bcid.report.proof_page import evidence

    outcome = json.loads((ROOT / "docs" / "results" / "prove.json").read_text(encoding="utf-8"))
    assert evidence(outcome) in (ROOT / "README.md").read_text(encoding="utf-8")


def test_the_page_of_effects_is_what_the_command_makes() -> None:
    from bcid.effects.listing import as_markdown
    from bcid.effects.table import EFFECTS

    page = (ROOT / "docs" / "effects.md").read_text(encoding="utf-8")
    assert page == as_markdown(list(EFFECTS.values())) + "\n"
    for effect in EFFECTS.values():
        assert f"`{effect.id}`" in page
