"""A portable controller as a Functional Mock-up Unit."""

from stepgap.export.controller.c_source import c_source
from stepgap.export.controller.fmu.description import FmiVersion
from stepgap.export.controller.fmu.package import fmu_file
from stepgap.export.controller.portable_controller import PortableController


def controller_fmu(controller: PortableController, version: FmiVersion) -> bytes:
    """Content of an FMU that plans a step of the robot in each communication step.

    Args:
        controller: The controller.
        version: Version of FMI.

    Raises:
        InputError: There is no C compiler, or none for this system.
    """
    source = c_source(controller, "controller")
    return fmu_file(controller.space, {"controller.h": source.header, "controller.c": source.code}, version)
