"""Documents are read back by the definition that wrote them, and their published schemas are those of the code."""

from __future__ import annotations

import json
import math
import subprocess
import sys
from pathlib import Path

import pytest

from bcid.documents.diagnosis import DiagnosisDocument
from bcid.documents.document import Document
from bcid.documents.prove import ProveDocument
from bcid.documents.report import ModelScore, ReportDocument
from bcid.documents.schemas import DOCUMENTS, schema_text
from bcid.errors import InputRefused

REMAINDER = """{"schema": "bcid.diagnosis/2", "verdict": "named", "remainder": [
 {"channel": "fx", "nats_before": 120.0, "nats_left": 1.5, "curve": {"quantity": "v_x", "unit": "m/s",
  "y_unit": "m/s^2", "x": [0.5, 1.5], "y": [-0.1, null], "sd": [0.1, 0.2], "named": [1.0, 2.0]}},
 {"channel": "pose", "nats_before": 1.0, "nats_left": 0.0, "curve": null}]}"""

DOCS = Path(__file__).parent.parent / "docs"


@pytest.mark.parametrize("name", DOCUMENTS)
def test_the_published_schema_is_that_of_the_code(name: str) -> None:
    """`python -m bcid.documents docs/schemas` renews it."""
    assert (DOCS / "schemas" / f"{name}.schema.json").read_text(encoding="utf-8") == schema_text(name)


@pytest.mark.parametrize(
    ("kind", "name"), [(DiagnosisDocument, "diagnosis"), (ProveDocument, "prove"), (ReportDocument, "report")]
)
def test_committed_documents_are_read_and_written_alike(kind: type[Document], name: str, tmp_path: Path) -> None:
    path = DOCS / "results" / f"{name}.json"
    kind.read(path).write(tmp_path / "again.json")
    before, after = (json.loads(p.read_text(encoding="utf-8")) for p in (path, tmp_path / "again.json"))
    assert {k: after[k] for k in before} == before
    assert kind.read(tmp_path / "again.json") == kind.read(path)


def test_both_versions_of_a_diagnosis_are_read_and_written_as_they_are(tmp_path: Path) -> None:
    """Version 2 holds what free functions explain in each channel; in version 1 there is none."""
    (tmp_path / "2.json").write_text(REMAINDER, encoding="utf-8")
    (tmp_path / "1.json").write_text('{"schema": "bcid.diagnosis/1", "verdict": "unknown"}', encoding="utf-8")
    second, first = (DiagnosisDocument.read(tmp_path / f"{n}.json") for n in "21")
    assert first.remainder == ()
    law = second.remainder[0].curve
    assert law is not None
    assert law.named == (1.0, 2.0)
    assert math.isnan(law.y[1])
    for document, kind in ((first, "bcid.diagnosis/1"), (second, "bcid.diagnosis/2")):
        document.write(tmp_path / "again.json")
        assert DiagnosisDocument.read(tmp_path / "again.json").as_json() == document.as_json()
        assert json.loads((tmp_path / "again.json").read_text(encoding="utf-8"))["schema"] == kind
    assert DiagnosisDocument(verdict="unknown").as_json()["schema"] == "bcid.diagnosis/2"


def test_what_is_not_a_number_is_null() -> None:
    assert ModelScore(model="k-mlp", parameters=3, nmse=float("nan")).as_json()["nmse"] is None


@pytest.mark.parametrize(
    ("text", "place"),
    [
        ('{"verdict": "named"}', "schema"),
        ('{"schema": "bcid.diagnosis/1", "verdict": "named", "duration_s": "600"}', "duration_s"),
        ('{"schema": "bcid.diagnosis/1", "verdict": "named", "duration_s": true}', "duration_s"),
        ('{"schema": "bcid.diagnosis/3", "verdict": "named"}', "schema"),
        (REMAINDER.replace("[0.1, 0.2]", "[0.1]"), "remainder"),
        (REMAINDER.replace("[1.0, 2.0]", "[1.0]"), "remainder"),
    ],
)
def test_nothing_is_read_into_what_is_written(text: str, place: str, tmp_path: Path) -> None:
    """No default for what a document is, no text or truth value for a number."""
    (tmp_path / "diagnosis.json").write_text(text)
    with pytest.raises(InputRefused, match=place):
        DiagnosisDocument.read(tmp_path / "diagnosis.json")


def test_what_is_not_a_number_is_written_and_read_as_null(tmp_path: Path) -> None:
    document = DiagnosisDocument(verdict="unknown", channels={"fx": float("nan")}, duration_s=float("inf"))
    document.write(tmp_path / "diagnosis.json")
    again = DiagnosisDocument.read(tmp_path / "diagnosis.json")
    assert math.isnan(again.channels["fx"])
    assert again.duration_s is None


def test_a_damaged_document_is_refused_by_field(tmp_path: Path) -> None:
    path = tmp_path / "diagnosis.json"
    path.write_text('{"schema": "bcid.diagnosis/1", "verdict": "perhaps", "horizons": [{"lost": 1}]}')
    with pytest.raises(InputRefused, match=r"verdict, horizons\.0\.horizon_s"):
        DiagnosisDocument.read(path)
    path.write_text('{"schema": ')
    with pytest.raises(InputRefused, match="JSON"):
        DiagnosisDocument.read(path)
    with pytest.raises(InputRefused, match="cannot be read"):
        DiagnosisDocument.read(tmp_path / "absent.json")


@pytest.mark.parametrize(
    ("after", "code", "said"),
    [
        ({"nmse": 0.123, "seconds": 2.0, "added": 1}, 0, "0 differ; added: added"),
        ({"nmse": 0.124, "seconds": 1.0}, 1, "/nmse: 0.123 -> 0.124"),
        ({}, 1, "report.json: missing in"),
    ],
    ids=["same", "one digit", "no file"],
)
def test_two_runs_are_compared_to_the_last_digit(after: dict[str, float], code: int, said: str, tmp_path: Path) -> None:
    for name, content in (("before", {"nmse": 0.123, "seconds": 1.0}), ("after", after)):
        (tmp_path / name).mkdir()
        if content:
            (tmp_path / name / "report.json").write_text(json.dumps(content), encoding="utf-8")
    command = [sys.executable, str(Path(__file__).parent / "compare_results.py"), "before", "after"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert said in done.stdout
    assert done.returncode == code, done.stderr
