"""`python -m catalogue > ../docs/recordings.md` in this folder's parent: the docs of bad recordings."""

from __future__ import annotations

import json
from pathlib import Path

import typer

from catalogue.table import catalogue_table, counts_told, faults_table, kills_told

ROOT = Path(__file__).parents[2]


def page() -> str:
    """The whole page."""
    golden = json.loads((ROOT / "tests" / "catalogue" / "golden.json").read_text(encoding="utf-8"))
    found = json.loads((ROOT / "docs" / "results" / "faults.json").read_text(encoding="utf-8"))
    return f"""# Recordings that are not as they should be

## Faults on purpose
`make faults` counts all that follows. `make fuzz N=10000` reads mutants of every kind of file: bits, bytes and spans
flipped, lost, doubled, zeroed or exchanged, nasty cells, lines, separators and encodings. A traceback, a hang beyond
10 s, other values in a file whose bytes are vouched for (MCAP with checksums, saved models, artifacts), values that
nobody wrote in what is salvaged and vouched for, and samples lost without a word are failures. The numbers are in
docs/results/faults.json.

{faults_table(found["fuzz"])}
{kills_told(found["kills"])}
{counts_told(found)}

## Ways to be wrong, and what is said
Made by code from one clean drive (`tests/catalogue`), numbers shown as #. The clean drive is read without a word.
*Refused*: one error with exit code 4, and the next step. *Read*: used, and what is *fixed* (the same values, written
otherwise), *excluded* (left out, counted and located) or only a *warning* is told. Rows of one number are of one kind.

{catalogue_table(golden)}
"""


if __name__ == "__main__":
    typer.echo(page(), nl=False)
