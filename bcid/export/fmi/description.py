"""What an FMU says of itself: modelDescription.xml of both versions, and buildDescription.xml of 3.0."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple
from xml.etree.ElementTree import Element, SubElement, indent, tostring

from bcid import __version__
from bcid.export.exported import Exported
from bcid.export.formulas import POSE, START, TWIST, Variable

UNITS: dict[str, dict[str, int]] = {
    "s": {"s": 1}, "m": {"m": 1}, "rad": {"rad": 1}, "m/s": {"m": 1, "s": -1}, "rad/s": {"rad": 1, "s": -1},
    "N": {"kg": 1, "m": 1, "s": -2},
}  # fmt: skip
"""Units of quantities as powers of the base units."""

OUTPUTS = (*POSE, *TWIST)
"""Pose and twist of one point; at the start they are the parameters at the same places in `START`."""

STATE_PREFIX = "x."
"""Before the names of the model's states, which may be called as outputs are."""

VARIABILITY = {"input": "continuous", "output": "continuous", "parameter": "fixed", "local": "discrete"}
INITIAL = {"output": "calculated", "parameter": "exact", "local": "calculated"}

AT_THE_START = " at the start"
"""What is added to what a quantity means, of a parameter."""

RULE = "Communication steps are whole multiples of the period; commands hold for a whole step."


class ModelVariable(NamedTuple):
    """A variable of an FMU, at the place in its array of values that `reference` is (fmu-vehicle.h)."""

    reference: int
    causality: str
    quantity: Variable


def list_variables(e: Exported) -> list[ModelVariable]:
    """All variables but the time, whose reference is 0, in the order of their references: from 1 on, without a gap.

    In FMI 2.0, where the time is no variable, a reference is thus also the index by which others depend on it.
    """
    states = [state._replace(name=STATE_PREFIX + state.name) for state in e.formulas.states]
    outputs, starts = (
        [q._replace(meaning=f"{q.meaning}{when}, of the {e.point}") for q in quantities]
        for quantities, when in ((OUTPUTS, ""), (START, AT_THE_START))
    )
    starts[-1] = START[-1]._replace(meaning=START[-1].meaning + AT_THE_START)
    kinds = [("input", e.commands), ("output", outputs), ("parameter", starts), ("local", states)]
    listed = [(causality, quantity) for causality, quantities in kinds for quantity in quantities]
    return [ModelVariable(i, causality, quantity) for i, (causality, quantity) in enumerate(listed, start=1)]


def describe_fmi2(e: Exported, guid: str, sources: Iterable[str]) -> str:
    """The text of modelDescription.xml of FMI 2.0, with the names of its C `sources`."""
    root = _begin(e, fmiVersion="2.0", guid=guid)
    simulation = SubElement(
        root, "CoSimulation", modelIdentifier=e.name, canGetAndSetFMUstate="true", canSerializeFMUstate="true",
        # This version has no word for whole multiples of a period: importers must not take just any step.
        canHandleVariableCommunicationStepSize="false", canNotUseMemoryManagementFunctions="true",
    )  # fmt: skip
    files = SubElement(simulation, "SourceFiles")
    for name in sources:
        SubElement(files, "File", name=name)
    variables = list_variables(e)
    _add_definitions(root, e, variables)
    listed = SubElement(root, "ModelVariables")
    for variable in variables:
        scalar = SubElement(listed, "ScalarVariable", _attributes(variable))
        SubElement(scalar, "Real", _unit_and_start(variable))
    structure = SubElement(root, "ModelStructure")
    outputs, unknowns = SubElement(structure, "Outputs"), SubElement(structure, "InitialUnknowns")
    for output, parameter in _outputs_by_parameter(variables):
        SubElement(outputs, "Unknown", index=str(output.reference), dependencies="")
        SubElement(unknowns, "Unknown", index=str(output.reference), dependencies=str(parameter.reference))
    return _as_text(root)


def describe_fmi3(e: Exported, token: str) -> str:
    """The text of modelDescription.xml of FMI 3.0."""
    root = _begin(e, fmiVersion="3.0", instantiationToken=token)
    SubElement(
        root, "CoSimulation", modelIdentifier=e.name, canGetAndSetFMUState="true", canSerializeFMUState="true",
        canHandleVariableCommunicationStepSize="true", fixedInternalStepSize=repr(e.formulas.period_s),
    )  # fmt: skip
    variables = list_variables(e)
    _add_definitions(root, e, variables)
    listed = SubElement(root, "ModelVariables")
    SubElement(
        listed, "Float64", name="time", valueReference="0", causality="independent", variability="continuous",
        unit="s", description="time",
    )  # fmt: skip
    for variable in variables:
        SubElement(listed, "Float64", _attributes(variable) | _unit_and_start(variable))
    structure = SubElement(root, "ModelStructure")
    pairs = _outputs_by_parameter(variables)
    for output, _ in pairs:
        SubElement(structure, "Output", valueReference=str(output.reference), dependencies="")
    for output, parameter in pairs:
        SubElement(
            structure, "InitialUnknown", valueReference=str(output.reference), dependencies=str(parameter.reference)
        )
    return _as_text(root)


def describe_build(e: Exported, sources: Iterable[str]) -> str:
    """The text of buildDescription.xml of FMI 3.0, with the names of its C `sources`."""
    root = Element("fmiBuildDescription", fmiVersion="3.0")
    configuration = SubElement(root, "BuildConfiguration", modelIdentifier=e.name)
    files = SubElement(configuration, "SourceFileSet", language="C99")
    for name in sources:
        SubElement(files, "SourceFile", name=name)
    return _as_text(root)


def _begin(e: Exported, **attributes: str) -> Element:
    """The root of a modelDescription.xml."""
    return Element(
        "fmiModelDescription", attributes, modelName=e.name, description=f"{e.about}. {RULE}",
        generationTool=f"bcid {__version__}", variableNamingConvention="structured",
    )  # fmt: skip


def _add_definitions(root: Element, e: Exported, variables: Sequence[ModelVariable]) -> None:
    """Units, what is logged, and the length of a step where nobody asks for another."""
    definitions = SubElement(root, "UnitDefinitions")
    for name in sorted({"s", *(v.quantity.unit for v in variables)} - {""}):
        unit = SubElement(definitions, "Unit", name=name)
        if name in UNITS:
            SubElement(unit, "BaseUnit", {base: str(power) for base, power in UNITS[name].items()})
    categories = SubElement(root, "LogCategories")
    SubElement(categories, "Category", name="logStatusError", description="why a call was refused")
    SubElement(root, "DefaultExperiment", startTime="0.0", stepSize=repr(e.formulas.period_s))


def _attributes(variable: ModelVariable) -> dict[str, str]:
    """What both versions say of a variable."""
    causality, quantity = variable.causality, variable.quantity
    known = {
        "name": quantity.name, "valueReference": str(variable.reference),
        "description": quantity.meaning,
        "causality": causality, "variability": VARIABILITY[causality],
    }  # fmt: skip
    return known | ({"initial": INITIAL[causality]} if causality in INITIAL else {})


def _unit_and_start(variable: ModelVariable) -> dict[str, str]:
    """The unit of a variable, where it has one, and its start: a vehicle at rest at the origin, without commands."""
    unit = variable.quantity.unit
    starts = variable.causality in ("input", "parameter")
    return ({"unit": unit} if unit else {}) | ({"start": "0.0"} if starts else {})


def _outputs_by_parameter(variables: Sequence[ModelVariable]) -> list[tuple[ModelVariable, ModelVariable]]:
    """The outputs, none of which depends on a command before a step, each with the parameter that it begins with."""
    outputs, parameters = ([v for v in variables if v.causality == kind] for kind in ("output", "parameter"))
    return list(zip(outputs, parameters, strict=False))


def _as_text(root: Element) -> str:
    """An indented document."""
    indent(root)
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + tostring(root, encoding="unicode") + "\n"
