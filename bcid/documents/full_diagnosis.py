"""diagnosis.json as it is published: the diagnosis, and what the prediction error is made of.

It stands apart from `bcid.documents.diagnosis`, on whose code kept rows of blind tests depend.
"""

from bcid.documents.diagnosis import DiagnosisDocument
from bcid.documents.error_budget import ErrorBudget


class FullDiagnosis(DiagnosisDocument):
    """The whole of diagnosis.json as `bcid diagnose` writes it; of earlier ones `error_budget` is null."""

    error_budget: ErrorBudget | None = None  # null where no prediction stays finite
