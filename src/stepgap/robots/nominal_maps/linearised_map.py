"""A map linearised at the step that holds a target: the model of the methods of linear control."""

from stepgap.control.reach import whole_states
from stepgap.control.step_controller import StepController
from stepgap.robots.nominal_maps.affine_map import AffineMap
from stepgap.step import Array, StepMap


def linearised(step_map: StepMap, target: Array) -> AffineMap:
    """The affine map with the value and the derivatives of a map at the step that holds a target.

    If no command holds it, that is the step from the target that comes nearest to it.

    Args:
        target: State, NaN in coordinates that are found as those of a state that some command repeats; shape (n,).

    Raises:
        StepFailed: No command was found that makes a step from there.
    """
    (state,) = whole_states(step_map, target[None])
    command = StepController(step_map)(state, target).command
    return AffineMap(step_map.space, state, command, step_map(state, command), step_map.jacobian(state, command))
