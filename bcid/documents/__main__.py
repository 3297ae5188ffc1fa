"""`python -m bcid.documents FOLDER`: the JSON schema of every document, written into FOLDER (docs/schemas)."""

import sys
from pathlib import Path

from bcid.documents.schemas import write_schemas

write_schemas(Path(sys.argv[1]))
