"""The JSON schemas of all documents, as docs/schemas publishes them."""

import json
from pathlib import Path

from bcid.documents.adapt import AdaptDocument
from bcid.documents.comparison import ComparisonDocument
from bcid.documents.diagnosis import DiagnosisDocument
from bcid.documents.document import Document
from bcid.documents.export import ExportDocument
from bcid.documents.fleet import FleetDocument
from bcid.documents.health import HealthDocument
from bcid.documents.manifest import ManifestDocument
from bcid.documents.model_card import ModelCard
from bcid.documents.pool import PoolDocument
from bcid.documents.prove import ProveDocument
from bcid.documents.prove_real import RealProofDocument
from bcid.documents.report import EvaluationDocument, ReportDocument
from bcid.documents.varied_limits import VariedLimitsDocument

DOCUMENTS: dict[str, type[Document]] = {
    "adapt": AdaptDocument,
    "compare": ComparisonDocument,
    "diagnosis": DiagnosisDocument,
    "evaluation": EvaluationDocument,
    "export": ExportDocument,
    "fleet": FleetDocument,
    "health": HealthDocument,
    "limits": VariedLimitsDocument,
    "manifest": ManifestDocument,
    "model_card": ModelCard,
    "pool": PoolDocument,
    "prove": ProveDocument,
    "prove_real": RealProofDocument,
    "report": ReportDocument,
}
"""Every document by the name of its schema."""


def schema_text(name: str) -> str:
    """The published JSON schema (draft 2020-12) of a document such as "diagnosis", a key of DOCUMENTS, as text."""
    return json.dumps(DOCUMENTS[name].model_json_schema(), indent=1, ensure_ascii=False) + "\n"


def write_schemas(folder: Path) -> None:
    """Write the schema of every document to `folder`/NAME.schema.json."""
    folder.mkdir(parents=True, exist_ok=True)
    for name in DOCUMENTS:
        (folder / f"{name}.schema.json").write_text(schema_text(name), encoding="utf-8")
