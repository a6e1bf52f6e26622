"""A portable controller as one Python file that needs NumPy alone: a `StepFilter`, what it uses, and the model."""

import json
from typing import Final

from stepgap.base.versions import versions_here
from stepgap.export.controller.model_document import model_document
from stepgap.export.controller.one_file import Place, one_file
from stepgap.export.controller.passport import passport_lines
from stepgap.export.controller.portable_controller import PortableController

FILTER: Final = "stepgap.export.controller.step_filter"
"""Module of the filter."""

INSTEAD: Final = {
    Place("stepgap.control.gauss_newton", "_gesv"): Place(FILTER, "solved_square"),
    Place("stepgap.base.compiled", "compiled"): Place(FILTER, "uncompiled"),
}
"""What takes the place of functions that need more than NumPy, or much more than the filter does."""

USE: Final = """
    from controller import MODEL, StepFilter

    controller = StepFilter(MODEL)
    command = None
    while True:
        ...  # measure the state, and choose the target; state = None if there is none, or if it is too old
        status, command, predicted, std = controller.plan(state, target, command)
        ...  # make the step with this command, whatever the status is; measure next_state
        controller.update(state, command, next_state)
"""


def python_source(controller: PortableController) -> str:
    """Writes a controller as a Python file.

    Args:
        controller: The controller.

    Raises:
        InputError: As of `model_document`.
    """
    document = model_document(controller)
    for part in document["residual"]["regressions"]:
        del part["data"]
    if document["beliefs"] is not None:
        del document["beliefs"]["steps"], document["beliefs"]["constants"], document["beliefs"]["probes"]
    space, notes = controller.space, [*map(str, controller.approximations), *controller.notes]
    lines = [
        "A step controller that was learned by StepGap: the command with which the next state is a target.",
        *passport_lines(controller.passport),
        "",
        f"Written by StepGap {versions_here()['stepgap']}; the code is part of it (MIT licence). It needs NumPy alone.",
        "",
        *(f"State: {each.name} [{each.unit}], range of use {each.lower:g} to {each.upper:g}" for each in space.state),
        *(f"Command: {each.name} [{each.unit}], bounds {each.lower:g} to {each.upper:g}" for each in space.command),
        USE,
        *(f"- {note}" for note in notes),
    ]
    head = "\n".join(lines).replace("\\", "\\\\").replace('"""', "'''")
    code = one_file([Place(FILTER, "StepFilter")], INSTEAD)
    model = f"MODEL = json.loads(\n    {json.dumps(document, allow_nan=False)!r}\n)"
    return (
        f'"""{head}\n"""\n\n{code}\n\nimport json\n\n{model}\n"""The documented model, which `StepFilter` reads."""\n'
    )
