"""`stepgap steps` on the encoder counts of a run of the twin, beside its true states and those measured online.

    ./go stepgap run --seed 5 --iterations 1 --out RUN
    ./go python benchmarks/step_extraction_twin.py RUN

The boom's encoders have 16,384 counts per turn for the pitch (0.7 mm at the hip) and 5,000 for the yaw (2.3 mm). Their
zeros are unknown, so heights are compared after their means are subtracted. The number of the step in the ticks stands
for the plan; it says which row of the run a step belongs to.
"""

import argparse
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

import stepgap
from stepgap.experiment.replay import replay
from stepgap.logs.sections.section_settings import SectionSettings
from stepgap.logs.sections.step_extraction import extract_steps
from stepgap.robots.hopper.robot import Hopper
from stepgap.step import Array


def errors(name: str, found: Array, true: Array) -> str:
    """One row: mean error and RMSE of the speed, standard deviation of the error of the height."""
    apart = found - true
    speed, height = 1e3 * apart[:, 0], 1e3 * (apart[:, 1] - apart[:, 1].mean())
    return f"{name} | {speed.mean():+.2f} | {np.sqrt(np.mean(speed**2)):.2f} | {height.std():.3f}"


def main() -> None:
    """Prints how many hops were found and how far their states are from the truth."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", type=Path)
    run = stepgap.load_run(parser.parse_args().run)
    robot = run.robot
    assert isinstance(robot, Hopper)
    ticks = replay(run, iteration=1)
    columns = ("time", "boom_vertical", "boom_horizontal", "step")
    settings = SectionSettings(
        boom=robot.parameters.boom_length, pitch="boom_vertical", yaw="boom_horizontal",
        state=("speed=rate(forward)", "height"), command=("step",),
        factors={"boom_vertical": 2 * np.pi / 16384, "boom_horizontal": 2 * np.pi / 5000},
    )  # fmt: skip
    with TemporaryDirectory() as folder:
        log = Path(folder) / "ticks.csv"
        rows = np.stack([np.asarray(ticks[name], float) for name in columns], axis=-1)
        np.savetxt(log, rows, delimiter=",", header=",".join(columns), comments="")
        found = extract_steps(str(log), None, settings)
    steps = np.genfromtxt(run.folder / "steps.csv", delimiter=",", names=True, dtype=None, encoding="utf-8")
    steps = steps[steps["iteration"] == 1]
    number = found.values["command"][found.kept, 0].astype(int) - 1
    true, online = (
        np.stack([steps[f"{kind}next_speed"], steps[f"{kind}next_height"]], axis=-1) for kind in ("true_", "")
    )
    print(f"{len(steps)} steps; {len(found.sections.time)} sections found, {len(found.kept)} steps kept")
    print("state | mean error of speed [mm/s] | RMSE of speed [mm/s] | std of the error of height [mm]")
    ends = found.sections.state[np.array(found.kept) + 1]
    print(errors("stepgap steps", ends, true[number]))
    print(errors("measured online", online[number], true[number]))
    stds = 1e3 * np.median(found.sections.std, axis=0)
    print(f"median standard errors of stepgap steps: {stds[0]:.2f} mm/s, {stds[1]:.3f} mm")


if __name__ == "__main__":
    main()
