"""Figures over state and command: errors, and the learned correction."""

from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.text import Text
from matplotlib.transforms import Bbox

from stepgap.experiment.run import Run
from stepgap.learning.observations import Observations
from stepgap.learning.residual_fit import fit_residual
from stepgap.learning.steps import Steps
from stepgap.records.missing import Missing
from stepgap.records.summary import Summary
from stepgap.report.analysis import Analysis, centre_of
from stepgap.report.drawing import LOOK
from stepgap.report.figures.learned import influential, surface_figure
from stepgap.report.figures.state_errors import shown_coordinates, state_error_figure
from stepgap.report.learned_residual import LearnedResidual
from stepgap.report.own_style import own_style
from stepgap.report.reference_gait import central_target, reference_gait
from stepgap.robots.hopper.paper import paper_reference
from stepgap.step import Quantity, StepSpace
from tests.control.maps import LossyHopper

SPACE = LossyHopper().space


def learned_from(kind: str) -> LearnedResidual:
    """A residual whose speed error depends on speed and fx, and whose height error depends on nothing but fy."""
    rng = np.random.default_rng(0)
    state, command = rng.uniform([0.15, 0.53], [0.25, 0.63], (50, 2)), rng.uniform(-10, 10, (50, 2))
    error = np.stack([0.3 * state[:, 0] + 0.002 * command[:, 0], 0.001 * command[:, 1]], axis=1)
    noise = rng.normal(size=error.shape) * [1e-4, 1e-4]
    return LearnedResidual(1, fit_residual(kind, Observations(SPACE, state, command, error + noise)))


def test_errors_are_drawn_against_every_coordinate(hopper_run: Path) -> None:
    steps = Run(hopper_run).steps.of_iteration(2)
    figure = state_error_figure(Run(hopper_run))
    values = np.hstack([steps.state, steps.requested])
    for index, axes in enumerate(figure.axes):
        row, column = divmod(index, 4)
        curves = {line.get_label(): line for line in axes.lines}
        tracking, predicted = (curves[label] for label in list(curves)[1:])
        np.testing.assert_array_equal(tracking.get_xdata(), values[:, column])
        np.testing.assert_array_equal(tracking.get_ydata(), (steps.next_state - steps.target)[:, row])
        np.testing.assert_array_equal(predicted.get_ydata(), (steps.next_state - steps.predicted)[:, row])


SHAPES = [(1, 1), (2, 2), (3, 2), (4, 3), (6, 2), (9, 1)]
SIZES = [2e-5, 1.0, 3e4]


@pytest.mark.parametrize(
    ("states", "commands", "size"),
    [*((6, 8, size) for size in SIZES), *((*shape, SIZES[number % 3]) for number, shape in enumerate(SHAPES))],
)
def test_commands_are_shown_and_no_text_is_printed_over_another(states: int, commands: int, size: float) -> None:
    names = ["foot_placement_lateral_offs", "x", "yaw_rate", "height", "pitch", "roll", "speed", "side_speed", "lean"]
    space = StepSpace(
        tuple(Quantity(name, "m/s", 3 * size, 5 * size) for name in names[:states]),
        tuple(Quantity(f"push_of_the_leg_{number}", "N·m", -size, size) for number in range(commands)),
    )
    rng, steps = np.random.default_rng(0), 60
    state = size * (4 + 0.1 * rng.normal(size=(steps, states)))
    log = Steps.of_columns(
        space,
        state=state,
        target=np.full_like(state, 4 * size),
        command=size * rng.uniform(-1, 1, (steps, commands)),
        next_state=np.roll(state, 1, axis=0),
        predicted=np.full_like(state, 4 * size),
    )
    rows, columns = shown_coordinates(log)
    assert len(rows) == min(states, 6)
    assert len(columns) == min(states + commands, 6)
    assert sum(column >= states for column in columns) == min(commands, max(3, 6 - states))
    with own_style(LOOK):
        figure = state_error_figure(Run("none", recorded=log, space=space, summary=Summary()))
        assert len(figure.axes) == len(rows) * len(columns)
        assert overlapping_texts(figure) == []


def overlapping_texts(figure: Figure) -> list[tuple[str, str]]:
    """Pairs of texts that are printed over each other."""
    drawn: dict[Text, Bbox] = {}
    draw = Text.draw

    def noted(text: Text, renderer: Any) -> None:
        draw(text, renderer)
        if text.get_visible() and text.get_text().strip():
            drawn[text] = text.get_window_extent(renderer).padded(-1)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Text, "draw", noted)
        FigureCanvasAgg(figure).draw()
    assert len(drawn) > 4
    pairs = combinations(drawn.items(), 2)
    return [(one.get_text(), other.get_text()) for (one, a), (other, b) in pairs if a.overlaps(b)]


def test_the_surface_is_over_the_inputs_that_matter() -> None:
    learned = learned_from("linear")
    centre = centre_of(learned, Missing("no map"))
    points = learned.residual.regressions[0].points
    np.testing.assert_array_equal(centre, np.median(points, axis=0))
    assert influential(learned.residual, points, centre, 0) == (0, 2)
    assert 3 in influential(learned.residual, points, centre, 1)
    figure = surface_figure(SPACE, learned, centre)
    mean, std, *_ = [axes for axes in figure.axes if axes.get_title(loc="left")]
    assert (mean.get_xlabel(), mean.get_ylabel()) == ("Speed [m/s]", "Fx [N]")
    assert mean.get_title(loc="left") == "Correction of speed [m/s]"
    for axes in (mean, std):
        (recorded,) = axes.lines
        np.testing.assert_array_equal(recorded.get_xdata(), points[:, 0])
        np.testing.assert_array_equal(recorded.get_ydata(), points[:, 2])


@pytest.mark.parametrize("kind", ["constant", "gp"])
def test_a_surface_of_any_shape_can_be_drawn(kind: str) -> None:
    learned = learned_from(kind)
    surface_figure(SPACE, learned, centre_of(learned, None)).draw_without_rendering()


def test_the_other_inputs_are_those_of_the_middle_gait(hopper_run: Path) -> None:
    record = Run(hopper_run)
    learned = Analysis(record).learned
    assert isinstance(learned, LearnedResidual)
    gait = reference_gait(record, LossyHopper(), learned)
    centre = centre_of(learned, gait)
    np.testing.assert_array_equal(centre[:2], gait.centre)
    points = gait.maps[1].points
    assert any(point is not None and (point.command == centre[2:]).all() for point in points)


def test_a_target_at_rest_does_not_move_the_central_target() -> None:
    targets = np.unique(paper_reference().targets, axis=0)
    centre = central_target(targets, SPACE.state_scale)
    np.testing.assert_array_equal(centre, [0.281, 0.5963])
    np.testing.assert_array_equal(central_target(targets[1:], SPACE.state_scale), centre)
