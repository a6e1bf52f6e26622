"""A file of a prior is read as it was written, and one that was changed by others is refused with the reason."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from stepgap.mujoco_robots.quadruped.robot import Quadruped
from stepgap.records.prior_file import read_prior
from stepgap.robots.hopper.robot import Hopper

SPACE = Hopper().space
FILE = Hopper().prior()
assert FILE is not None
DATA = json.loads(FILE.read_text("utf-8"))


@pytest.mark.parametrize("robot", [Hopper(), Quadruped()])
def test_that_of_a_robot_is_for_it_and_is_written_as_it_was_read(robot: Hopper | Quadruped) -> None:
    path = robot.prior()
    assert path is not None
    found = read_prior(path, robot.space)
    assert json.loads(found.text()) == json.loads(path.read_text("utf-8"))
    assert found.robot == robot.name
    assert found.nominal == next(iter(robot.nominal_maps()))


def of_first(**changes: Any) -> Callable[[dict[str, Any]], None]:
    return lambda data: data["coordinates"][0].update(changes)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda data: data.update(format=1), "format must be 'stepgap prior 1'"),
        (lambda data: data["inputs"][0].update(name="\x1b[31m"), "it is for [31m, height"),
        (lambda data: data["inputs"][0].update(scale=1e-310), "inputs: scale must lie between"),
        (lambda data: data["inputs"][0].update(centre=-1e300), "inputs: centre must lie between"),
        (lambda data: data["coordinates"].reverse(), "coordinates must have the names speed, height, in this order"),
        (lambda data: data["coordinates"].pop(), "coordinates must have the names speed, height, in this order"),
        (lambda data: data["monomials"].reverse(), "monomials must be 1, speed, height"),
        (of_first(noise_std=0.0), "coordinates: noise_std must lie between"),
        (of_first(noise_std=1e300), "coordinates: noise_std must lie between"),
        (of_first(noise_std=True), "noise_std must be a number"),
        (of_first(mean=[0.0]), "coordinates: mean and covariance must have 15 numbers"),
        (of_first(mean=[1e200] * 15), "coordinates: mean must lie between"),
        (of_first(covariance=[[1.0], [1.0, 2.0]]), "covariance must be a list of equally long lists"),
        (of_first(covariance=[[0.0] * 15] * 15), "coordinates: covariance must be symmetric and positive definite"),
        (of_first(covariance=(1e-20 * np.eye(15)).tolist()), "coordinates: speed: noise_std, covariance, and centre"),
        (of_first(noise_std=1e-9), "their sizes differ by too many powers of ten"),
        (lambda data: data["inputs"][0].update(scale=1e-6), "their sizes differ by too many powers of ten"),
    ],
)
def test_what_was_changed_is_refused(tmp_path: Path, change: Callable[[dict[str, Any]], None], words: str) -> None:
    data = json.loads(json.dumps(DATA))
    change(data)
    path = tmp_path / "prior.json"
    path.write_text(json.dumps(data), "utf-8")
    with pytest.raises(ValueError, match=r"prior\.json: ") as found:
        read_prior(path, SPACE)
    assert words in str(found.value)
    assert str(found.value).isprintable()
