"""What is learned of a drive of a minute, which tests only read."""

import pytest

from stepgap.cure.drive import read_drive
from stepgap.cure.lesson import Lesson, lesson_of
from stepgap.cure.response import response_of
from tests.cure.drives import drive, written


@pytest.fixture(scope="session")
def minute(tmp_path_factory: pytest.TempPathFactory) -> Lesson:
    found = read_drive(written(tmp_path_factory.mktemp("minute"), *drive(60.0)))
    return lesson_of([found], response_of(found))
