"""Pictures of a robot: its points are where the projection puts them."""

import numpy as np
import pytest

from stepgap.gym.camera import FOOTROOM, HEADROOM, PIXELS, TILT, Shot, draw_shot
from stepgap.robots.scene import Link, Scene

TOP = 0.6
SIDE = (HEADROOM + FOOTROOM) * TOP
"""Width and height of the picture [m]."""


def ball_at(scene: Scene, positions: list[list[float]], ground: float = 0.0) -> tuple[float, float]:
    """Column, and row from below, of the black ball in a picture [pixels]."""
    picture = draw_shot(scene, Shot(np.array(positions), ground, ""), TOP)
    rows, columns = np.nonzero((picture < 60).all(axis=2))
    return float(columns.mean()) + 0.5, PIXELS - float(rows.mean()) - 0.5


@pytest.mark.parametrize("circle", [0.0, 1.5])
@pytest.mark.parametrize("progress", [0.0, 0.7])
@pytest.mark.parametrize("height", [0.2, 0.9])
def test_the_body_is_in_the_middle_at_its_height(circle: float, progress: float, height: float) -> None:
    scene = Scene({"hip": 0.03}, (), "hip", circle=circle)
    body = [progress, 0.0, height]
    if circle:
        body = [circle * np.sin(progress), -circle * np.cos(progress), height]
    column, row = ball_at(scene, [body])
    assert column == pytest.approx(PIXELS / 2, abs=1)
    assert row == pytest.approx((FOOTROOM * TOP + height * np.cos(TILT)) / SIDE * PIXELS, abs=1)


def test_a_link_is_as_wide_as_it_is() -> None:
    scene = Scene({"hip": 0.0, "foot": 0.0}, (Link("hip", "foot", 0.02, "near"),), "hip")
    picture = draw_shot(scene, Shot(np.array([[0, 0, 0.6], [0, 0, 0.1]]), 0.0, ""), TOP)
    row = picture[PIXELS - round((FOOTROOM * TOP + 0.35 * np.cos(TILT)) / SIDE * PIXELS)]
    blue = row[:, 2].astype(int) - row[:, 0] > 80
    assert blue.sum() == pytest.approx(0.04 / SIDE * PIXELS, abs=1.5)


def test_marks_of_the_track_move_with_the_robot() -> None:
    scene = Scene({"hip": 0.0}, (), "hip")
    here, further, at_next_mark = (
        draw_shot(scene, Shot(np.array([[x, 0, 0.5]]), 0.0, ""), TOP).tobytes() for x in (0.0, 0.03, 0.1)
    )
    assert here != further
    assert here == at_next_mark
