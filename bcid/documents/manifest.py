"""manifest.json: what an artifact was made from, and the digest of each of its files."""

from typing import Any, Literal

from pydantic import ConfigDict, Field

from bcid.documents.document import Document


class ManifestDocument(Document):
    """The whole of manifest.json (`bcid.artifact/1`); an unknown field is an edit, and makes another manifest of it."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    kind: Literal["bcid.artifact/1"] = Field("bcid.artifact/1", alias="schema")
    stage: str
    inputs: dict[str, Any]  # by content: hashes of files, keys of other artifacts
    settings: dict[str, Any]
    code: str  # digest of the stage's code with all that it imports
    packages: dict[str, str]  # versions of the libraries that it imports
    seed: int | None
    files: dict[str, str]  # SHA-256 by path within the artifact
