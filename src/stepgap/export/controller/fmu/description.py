"""`modelDescription.xml` of an exported controller, for FMI 2.0 and 3.0."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final, Literal, final
from xml.etree import ElementTree as ET

from stepgap.base.versions import versions_here
from stepgap.step import Quantity, StepSpace

FmiVersion = Literal[2, 3]
"""Major version of the Functional Mock-up Interface."""

IDENTIFIER: Final = "stepgap_controller"
"""Name of the model in its files."""

_TYPES: Final = {2: {"Float64": "Real", "Int32": "Integer", "Boolean": "Boolean"}}
"""Names of the types of FMI 3.0 in FMI 2.0."""


@final
@dataclass(frozen=True)
class _Variable:
    """A variable; its value reference is its position in the list, which is that of instance.h."""

    name: str
    kind: str
    causality: str
    start: str
    unit: str = ""
    description: str = ""

    @property
    def attributes(self) -> dict[str, str]:
        """Attributes of both versions, without those of the type."""
        variability = "fixed" if self.causality == "parameter" else "discrete"
        if self.causality == "independent":
            return {"causality": "independent", "variability": "continuous", "description": self.description}
        found = {"causality": self.causality, "variability": variability, "description": self.description}
        return {**found, "initial": "exact"} if self.causality == "output" else found


def model_description(space: StepSpace, version: FmiVersion, token: str) -> bytes:
    """Content of `modelDescription.xml`.

    Args:
        space: Names, units and ranges.
        version: Version of FMI.
        token: Text by which the binary recognises its description.
    """
    variables = _variables(space)
    root = ET.Element("fmiModelDescription", _root_attributes(version, token))
    abilities = _abilities(version)
    simulation = ET.SubElement(root, "CoSimulation", {"modelIdentifier": IDENTIFIER, **abilities})
    if version == 2:
        files = ET.SubElement(simulation, "SourceFiles")
        for name in ("fmi2.c", "controller.c"):
            ET.SubElement(files, "File", name=name)
    units = ET.SubElement(root, "UnitDefinitions")
    for unit in dict.fromkeys(each.unit for each in variables if each.unit):
        ET.SubElement(units, "Unit", name=unit)
    ET.SubElement(root, "DefaultExperiment", startTime="0", stepSize="1")
    listed = ET.SubElement(root, "ModelVariables")
    for reference, each in enumerate(variables):
        if version == 3 or each.causality != "independent":
            _add_variable(listed, each, reference, version)
    structure = ET.SubElement(root, "ModelStructure")
    outputs = [i for i, each in enumerate(variables) if each.causality == "output"]
    _add_outputs(structure, outputs, version)
    return ET.tostring(root, "utf-8", xml_declaration=True)


def build_description() -> bytes:
    """Content of `sources/buildDescription.xml` of FMI 3.0, by which the sources can be compiled elsewhere."""
    root = ET.Element("fmiBuildDescription", fmiVersion="3.0")
    build = ET.SubElement(root, "BuildConfiguration", modelIdentifier=IDENTIFIER)
    files = ET.SubElement(build, "SourceFileSet", language="C99")
    for name in ("fmi3.c", "controller.c"):
        ET.SubElement(files, "SourceFile", name=name)
    return ET.tostring(root, "utf-8", xml_declaration=True)


def _variables(space: StepSpace) -> list[_Variable]:
    """All variables, in the order of instance.h."""

    def group(name: str, quantities: Iterable[Quantity], causality: str, meaning: str, zero: bool) -> list[_Variable]:
        return [
            _Variable(
                f"{name}_{each.name}",
                "Float64",
                causality,
                "0.0" if zero else repr((each.lower + each.upper) / 2),
                each.unit,
                f"{meaning}: {each.name}",
            )
            for each in quantities
        ]

    phase = f"Phase of {space.periodic.name}" if space.periodic else "Phase of a periodic context"
    return [
        *group("state", space.state, "input", "Measured state at the section", zero=False),
        *group("target", space.state, "input", "State wanted at the next section", zero=False),
        _Variable("phase", "Float64", "input", "0.0", "rad", f"{phase} at the section; used if phase_known"),
        *group("command", space.command, "output", "Command of the step", zero=False),
        *group("predicted", space.state, "output", "Predicted next state", zero=True),
        *group("std", space.state, "output", "Standard deviation of the next state as measured", zero=True),
        _Variable("result", "Int32", "output", "0", description="0, or why no step was planned"),
        _Variable("completed", "Boolean", "input", "true", description="The last command led to the present state"),
        _Variable("phase_known", "Boolean", "parameter", "false", description="The phase is measured"),
        _Variable("time", "Float64", "independent", "", "", "Time; a communication step is a step of the robot"),
    ]


def _root_attributes(version: FmiVersion, token: str) -> dict[str, str]:
    by_version = {
        2: {"fmiVersion": "2.0", "guid": token},
        3: {"fmiVersion": "3.0", "instantiationToken": token},
    }
    return {
        **by_version[version],
        "modelName": "StepGap controller",
        "generationTool": f"StepGap {versions_here()['stepgap']}",
        "variableNamingConvention": "flat",
    }


def _abilities(version: FmiVersion) -> dict[str, str]:
    state = "FMUstate" if version == 2 else "FMUState"
    names = ["canHandleVariableCommunicationStepSize", f"canGetAndSet{state}", f"canSerialize{state}"]
    return dict.fromkeys([*names, *(["canNotUseMemoryManagementFunctions"] if version == 2 else [])], "true")


def _add_variable(listed: ET.Element, variable: _Variable, reference: int, version: FmiVersion) -> None:
    own = {key: value for key, value in (("start", variable.start), ("unit", variable.unit)) if value}
    common = {"name": variable.name, "valueReference": str(reference), **variable.attributes}
    if version == 3:
        ET.SubElement(listed, variable.kind, {**common, **own})
    else:
        ET.SubElement(ET.SubElement(listed, "ScalarVariable", common), _TYPES[2][variable.kind], own)


def _add_outputs(structure: ET.Element, outputs: list[int], version: FmiVersion) -> None:
    """Lists the outputs, none of which depends on an input before the next step."""
    if version == 3:
        for reference in outputs:
            ET.SubElement(structure, "Output", valueReference=str(reference))
        return
    listed = ET.SubElement(structure, "Outputs")
    for reference in outputs:
        ET.SubElement(listed, "Unknown", index=str(reference + 1))
