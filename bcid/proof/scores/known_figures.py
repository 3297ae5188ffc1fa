"""Findings that name nothing: that a figure of the simulation is another one in this car."""

from collections.abc import Mapping
from typing import Any

PARAMETER = "parameter"
"""Kind of a finding which says that a parameter, or the size of an effect, of the simulation is another one here."""


def naming_findings(row: Mapping[str, Any]) -> list[dict[str, Any]]:
    """The findings of a blind case's row but those that rightly say that a figure is another than published.

    Such a finding has the kind "parameter" and as its "effect" the symbol of a parameter, or the id of an effect
    (alone, or with a symbol: `effect__symbol`) of the simulation.  It is right if the row has the figure in
    "other_parameters" or in "also"; of any other figure it is a false name.
    """
    others = {*row.get("other_parameters", {}), *row.get("also", ())}
    return [
        finding
        for finding in row.get("findings", [])
        if finding.get("kind") != PARAMETER or finding["effect"].partition("__")[0] not in others
    ]


def without_known_figures(row: Mapping[str, Any]) -> dict[str, Any]:
    """A blind case's row with its `naming_findings` alone; one without findings stays as it is."""
    return {**row, "findings": naming_findings(row)} if "findings" in row else dict(row)
