"""Documents are read back by the definition that wrote them, and their published schemas are those of the code."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from bcid.documents.diagnosis import DiagnosisDocument
from bcid.documents.document import Document
from bcid.documents.report import ModelScore, ReportDocument
from bcid.documents.schemas import DOCUMENTS, schema_text
from bcid.errors import InputRefused

DOCS = Path(__file__).parent.parent / "docs"


@pytest.mark.parametrize("name", DOCUMENTS)
def test_the_published_schema_is_that_of_the_code(name: str) -> None:
    """`python -m bcid.documents docs/schemas` renews it."""
    assert (DOCS / "schemas" / f"{name}.schema.json").read_text(encoding="utf-8") == schema_text(name)


@pytest.mark.parametrize(("kind", "name"), [(DiagnosisDocument, "diagnosis"), (ReportDocument, "report")])
def test_committed_documents_are_read_and_written_alike(kind: type[Document], name: str, tmp_path: Path) -> None:
    path = DOCS / "results" / f"{name}.json"
    kind.read(path).write(tmp_path / "again.json")
    before, after = (json.loads(p.read_text(encoding="utf-8")) for p in (path, tmp_path / "again.json"))
    assert {k: after[k] for k in before} == before
    assert kind.read(tmp_path / "again.json") == kind.read(path)


def test_what_is_not_a_number_is_null() -> None:
    assert ModelScore(model="k-mlp", parameters=3, nmse=float("nan")).as_json()["nmse"] is None


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
