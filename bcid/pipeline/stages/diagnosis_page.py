"""Stage `diagnosis_page`: a diagnosis as one offline page, and the card of its model."""

from pathlib import Path

from bcid.diagnosis.summary import KNOT_UNITS, TRACK_UNITS
from bcid.documents.diagnosis import DiagnosisDocument
from bcid.files.parquet import read_columns
from bcid.pipeline.model_card import Origin, describe_diagnosed_model
from bcid.report.diagnosis_page import write_diagnosis_page


def run_diagnosis_page_stage(folder: Path, diagnosed: Path, origin: Origin) -> None:
    """Write diagnosis.html and model_card.json to `folder`, of the diagnosis in the artifact's folder `diagnosed`."""
    document = DiagnosisDocument.read(diagnosed / "diagnosis.json")
    card = describe_diagnosed_model(origin, document, diagnosed / "model")
    card.write(folder / "model_card.json")
    knots, tracks = (
        dict(zip(units, read_columns(diagnosed / name, units, undefined=tuple(units)).T, strict=True))
        for name, units in (("knots.parquet", KNOT_UNITS), ("tracks.parquet", TRACK_UNITS))
    )
    write_diagnosis_page(document, knots, tracks, folder / "diagnosis.html", card)
