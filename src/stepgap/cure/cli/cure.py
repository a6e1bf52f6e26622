"""The verb `stepgap cure`."""

import sys
from pathlib import Path

from stepgap.base.errors import InputError
from stepgap.base.files import create, new_folder
from stepgap.base.output_files import check_new, writing
from stepgap.cli.options import Name
from stepgap.cli.terminal import announces_compilation, print_table


@announces_compilation
def cure(
    *log: str,
    out: Path,
    command: Name = "",
    odometry: Name = "",
    distance: float | None = None,
    name: Name = "",
) -> None:
    """Correct a walking robot by a log of its velocity commands and odometry: what it does, and the corrector.

    Commands and odometry are found by the types of their messages. The new folder has a page, the passport of the
    robot, and the corrector in Python, C and as a node of ROS 2 with its launch file.

    Args:
        log: Logs of one robot, such as bags of ROS 2 or tables (docs/logs.md), with geometry_msgs/Twist or TwistStamped
            and nav_msgs/Odometry; files that belong together are joined as FILE+FILE.
        out: New folder.
        command: Topic of the commands, or three columns, if several may be meant.
        odometry: Topic of the odometry, or three columns of velocities, if several may be meant.
        distance: Distance from the place where the first log begins to that where it ends, measured by a tape [m]; 0 if
            the robot came back. Odometry that does not fit is refused.
        name: Name of the robot in the passport, such as its serial number. [default: that of the log]
    """
    from stepgap.cure.cure_folder import cure_files, name_of_log
    from stepgap.cure.cure_page import ERROR_HEADS, error_rows, verdict
    from stepgap.cure.drive import check_distance, read_drive
    from stepgap.cure.habits import habits_of
    from stepgap.cure.lesson import lesson_of
    from stepgap.cure.response import response_of, with_strays

    if not log:
        raise InputError("LOG: none given; give a recording of velocity commands and odometry, such as a bag of ROS 2")
    check_new(out, "--out")
    drives = [read_drive(one, command, odometry) for one in log]
    responses = [response_of(drive) for drive in drives]  # of all, so that signs, units and clocks of all are checked
    drives = [with_strays(*pair) for pair in zip(drives, responses, strict=True)]
    _, response = max(zip(drives, responses, strict=True), key=lambda pair: pair[0].seconds)
    checks = [] if distance is None else [check_distance(drives[0], distance)]
    for note in (*(note for drive in drives for note in drive.notes), *checks):
        print(note)
    print(response.in_words(), flush=True)
    lesson = lesson_of(drives, response)
    habits = habits_of(lesson)
    print()
    for habit in habits:
        print(habit.in_words())
    print()
    print_table(ERROR_HEADS, error_rows(lesson))
    print()
    print(verdict(lesson), flush=True)
    contents = cure_files(lesson, habits, checks, name or name_of_log(log[0]))
    with writing(out, "--out"), new_folder(out) as partial:
        for file, content in contents.items():
            create(partial / file, content)
    print(out / "index.html")
    if distance is None:
        advice = "--distance METRES, measured by a tape, says whether the odometry is right: what it does not see stays"
        print(advice, file=sys.stderr)
