"""How well `stepgap steps` finds the hops of logs: missed, duplicated, errors of the state, and rows that are wrong.

    ./go python benchmarks/step_extraction.py [--hops 200] [--seeds 41,42,43,44,45]

The logs are synthetic, so that the truth is known: ballistic flights with random apexes, joined by stances like those
of a spring. Each is made worse in one way, and in all at once: rounded to 0.1 to 5 mm, with noise, with rows that are
lost, with values that the sensor repeats or loses, at two sampling rates, and with glitches in the column of the phase.

A row of steps is wrong if its sections are not two successive true ones, if its plan is that of another step, or if its
state is off by more than five standard errors and by more than a twentieth of the spread of the states. What is left
out is counted, but is not wrong.
"""

import argparse
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from stepgap.records.sections.section_settings import SectionSettings
from stepgap.records.sections.step_extraction import ExtractedSteps, extract_steps
from stepgap.records.steps_csv import RecordError
from stepgap.step import Array

GRAVITY, TOUCHDOWN, STIFFNESS = 9.81, 0.5, 900.0  # m/s², height of touch-down [m], of the leg per mass [1/s²]


@dataclass(frozen=True)
class Log:
    """A log of ticks with what is true of it.

    Attributes:
        time: Times [s]; shape (R,).
        height: Heights [m]; shape (R,), NaN where it is missing.
        forward: Positions [m]; likewise.
        flight: Whether the phase says flight; shape (R,).
        force: Force on the foot, per mass [m/s²]; shape (R,).
        apexes: Times, speeds and heights of the K apexes; shape (K, 3).
    """

    time: Array
    height: Array
    forward: Array
    flight: Array
    force: Array
    apexes: Array


Change = Callable[[Log, np.random.Generator], Log]


def hopping(hops: int, rng: np.random.Generator, rate: float = 1000.0) -> Log:
    """A log of hops with random speeds and rises, without errors."""
    speeds, rises = rng.uniform(-0.5, 1.5, hops), rng.uniform(0.03, 0.12, hops)
    begin, place = 0.4, 0.0
    knots: list[tuple[float, float, float, float, float, bool]] = []  # begin, end, position, speed, launch, flight
    launch = 0.0
    for speed, rise in zip(speeds, rises, strict=True):
        launch = float(np.sqrt(2 * GRAVITY * rise))
        duration = 2 * launch / GRAVITY
        knots.append((begin, begin + duration, place, speed, launch, True))
        begin, place = begin + duration, place + speed * duration
        stance = (np.pi + 2 * np.arctan(GRAVITY / (np.sqrt(STIFFNESS) * launch))) / np.sqrt(STIFFNESS)
        knots.append((begin, begin + stance, place, speed, launch, False))
        begin, place = begin + stance, place + speed * stance
    time = np.arange(0, begin + 0.3, 1 / rate) + rng.uniform(0, 1 / rate)
    height, forward, flight = np.full(len(time), TOUCHDOWN), np.zeros(len(time)), np.zeros(len(time), bool)
    force = np.full(len(time), GRAVITY)
    for start, end, position, speed, launch, airborne in knots:
        rows = (time >= start) & (time < end)
        since = time[rows] - start
        if airborne:
            height[rows] = TOUCHDOWN + launch * since - GRAVITY / 2 * since**2
        else:
            omega = np.sqrt(STIFFNESS)
            sag = GRAVITY / STIFFNESS
            height[rows] = TOUCHDOWN - sag + sag * np.cos(omega * since) - launch / omega * np.sin(omega * since)
        forward[rows], flight[rows] = position + speed * since, airborne
        force[rows] = 0 if airborne else STIFFNESS * (TOUCHDOWN - height[rows])
    forward[time >= begin] = place
    tops = np.array(
        [
            (start + launch / GRAVITY, speed, TOUCHDOWN + launch**2 / (2 * GRAVITY))
            for start, _, _, speed, launch, airborne in knots
            if airborne
        ]
    )
    return Log(time, height, forward, flight, force, tops)


def rounded(step: float) -> Change:
    """Positions are rounded, as by an encoder."""
    return lambda log, _: replace(
        log, height=step * np.round(log.height / step), forward=step * np.round(log.forward / step)
    )


def noisy(std: float) -> Change:
    """Positions have normal noise [m]."""

    def change(log: Log, rng: np.random.Generator) -> Log:
        noise = rng.normal(0, std, (2, len(log.time)))
        return replace(log, height=log.height + noise[0], forward=log.forward + noise[1])

    return change


def vibrating(amplitude: float, frequency: float) -> Change:
    """A boom vibrates after each touch-down, at an amplitude [m] that decays in 0.1 s."""

    def change(log: Log, _: np.random.Generator) -> Log:
        landing = log.time[1:][log.flight[:-1] & ~log.flight[1:]]
        since = log.time - np.append(-np.inf, landing)[np.searchsorted(landing, log.time, "right")]
        vibration = amplitude * np.sin(2 * np.pi * frequency * np.minimum(since, 10)) * np.exp(-since / 0.1)
        return replace(log, height=log.height + vibration)

    return change


def weak_force(std: float, offset: float) -> Change:
    """The force has noise and an offset [m/s²]."""
    return lambda log, rng: replace(log, force=log.force + offset + rng.normal(0, std, len(log.force)))


def _rows(log: Log, keep: Array) -> Log:
    return replace(
        log,
        time=log.time[keep],
        height=log.height[keep],
        forward=log.forward[keep],
        flight=log.flight[keep],
        force=log.force[keep],
    )


def lost_rows(count: int, longest: float) -> Change:
    """Rows are lost for random times up to `longest` [s]."""

    def change(log: Log, rng: np.random.Generator) -> Log:
        keep = np.ones(len(log.time), bool)
        for begin in rng.uniform(log.time[0], log.time[-1], count):
            keep &= (log.time < begin) | (log.time > begin + rng.uniform(0, longest))
        return _rows(log, keep)

    return change


def lost_values(share: float) -> Change:
    """Single values are missing, or those of a sensor that returns zero."""

    def change(log: Log, rng: np.random.Generator) -> Log:
        kind = rng.uniform(size=len(log.time))
        height = np.where(kind < share, np.nan, np.where(kind < 2 * share, 0.0, log.height))
        return replace(log, height=height, forward=np.where(kind > 1 - share, np.nan, log.forward))

    return change


def repeated(count: int, longest: float) -> Change:
    """The sensor repeats its value for random times up to `longest` [s]."""

    def change(log: Log, rng: np.random.Generator) -> Log:
        height, forward = log.height.copy(), log.forward.copy()
        for begin in rng.uniform(log.time[0], log.time[-1], count):
            rows = np.flatnonzero((log.time >= begin) & (log.time <= begin + rng.uniform(0, longest)))
            if len(rows):
                height[rows], forward[rows] = height[rows[0]], forward[rows[0]]
        return replace(log, height=height, forward=forward)

    return change


def slower_forward(every: int) -> Change:
    """The position is sampled at a lower rate than the height."""
    return lambda log, _: replace(log, forward=np.where(np.arange(len(log.time)) % every == 0, log.forward, np.nan))


def slower(every: int) -> Change:
    """From the middle of the log on, only every so many-th row is written."""

    def change(log: Log, _: np.random.Generator) -> Log:
        rows = np.arange(len(log.time))
        return _rows(log, (rows < len(rows) / 2) | (rows % every == 0))

    return change


def glitches(count: int, longest: float) -> Change:
    """The phase is wrong for random times up to `longest` [s]."""

    def change(log: Log, rng: np.random.Generator) -> Log:
        flight = log.flight.copy()
        for begin in rng.uniform(log.time[0], log.time[-1], count):
            rows = (log.time >= begin) & (log.time <= begin + rng.uniform(0, longest))
            flight[rows] = ~flight[rows]
        return replace(log, flight=flight)

    return change


CASES: dict[str, tuple[Change, ...]] = {
    "as it is": (),
    **{f"rounded to {step:g} mm": (rounded(step / 1000),) for step in (0.1, 0.5, 1, 2, 5)},
    "noise 2 mm": (noisy(0.002),),
    "noise 10 mm": (noisy(0.01),),
    "vibration 2 mm, 25 Hz": (vibrating(0.002, 25), noisy(0.0002)),
    "force with noise, offset": (weak_force(1.5, 1.0), noisy(0.0002)),
    "rows lost": (lost_rows(40, 0.15),),
    "values lost, zeros": (lost_values(0.01),),
    "values repeated": (repeated(40, 0.08),),
    "rate / 5 from the middle": (slower(5),),
    "position at 100 Hz": (slower_forward(10),),
    "phase with glitches": (glitches(200, 0.02),),
    "phase with long glitches": (glitches(40, 0.15),),
    "all at once, 1 mm": (
        noisy(0.0005), rounded(0.001), lost_values(0.005), repeated(10, 0.03), lost_rows(20, 0.1), glitches(100, 0.02),
    ),
}  # fmt: skip


def write(log: Log, folder: Path, rng: np.random.Generator) -> None:
    """Writes log.csv and plan.csv; a plan is made shortly after its section, and its number is that of the step."""
    cells = [
        [f"{value:.9g}" if np.isfinite(value) else "" for value in column]
        for column in (log.height, log.forward, log.force)
    ]
    rows = zip(log.time.tolist(), *cells, np.where(log.flight, "FLIGHT", "STANCE").tolist(), strict=True)
    (folder / "log.csv").write_text(
        "time,height,forward,force,phase\n" + "".join(f"{t:.6f},{h},{x},{f},{p}\n" for t, h, x, f, p in rows)
    )
    plans = log.apexes[:, 0] + rng.uniform(0.002, 0.05, len(log.apexes))
    (folder / "plan.csv").write_text("time,number\n" + "".join(f"{t:.6f},{k}\n" for k, t in enumerate(plans.tolist())))


@dataclass(frozen=True)
class Score:
    """What was found in a log.

    Attributes:
        found: Sections that belong to a true one, of all.
        duplicated: Sections more than one that belong to a true one, or to none.
        silent: Duplicated sections without a doubt.
        steps: Steps that were written, of all.
        wrong: Steps that were written and are wrong.
        errors: Errors of speed and height of the steps that were written; shape (steps, 2).
        standardised: Their ratios to the standard errors.
        refused: Whether the whole log was refused.
    """

    found: int
    duplicated: int
    silent: int
    steps: int
    wrong: int
    errors: Array
    standardised: Array
    refused: bool


def score(log: Log, steps: ExtractedSteps) -> Score:
    """Compares extracted steps with the truth."""
    times, sections = log.apexes[:, 0], steps.sections
    nearest = np.abs(times[:, None] - sections.time).argmin(axis=0)
    belongs = np.abs(times[nearest] - sections.time) < 0.05
    _, first = np.unique(np.where(belongs, nearest, -1), return_index=True)
    extra = np.ones(len(sections.time), bool)
    extra[first] = False
    extra |= ~belongs
    doubtful = np.array([bool(doubt) for doubt in sections.doubts])
    kept = np.zeros(0, int) if steps.refusal else steps.kept
    spread, wrong = log.apexes[:, 1:].std(axis=0), 0
    errors, ratios = np.zeros((0, 2)), np.zeros((0, 2))
    for k in kept:
        apart = sections.state[k] - log.apexes[nearest[k], 1:]
        ratio = apart / sections.std[k]
        follows = belongs[k] and belongs[k + 1] and nearest[k + 1] == nearest[k] + 1
        planned = steps.values["command"][k, 0] == nearest[k]
        off = (np.abs(ratio) > 5) & (np.abs(apart) > spread / 20)
        wrong += bool(not follows or not planned or off.any())
        errors, ratios = np.vstack([errors, apart]), np.vstack([ratios, ratio])
    return Score(
        len(np.unique(nearest[belongs])), int(extra.sum()), int((extra & ~doubtful).sum()), len(kept), wrong, errors,
        ratios, bool(steps.refusal),
    )  # fmt: skip


def trial(changes: Sequence[Change], rule: str, hops: int, seed: int, folder: Path) -> Score | str:
    """Score of one log; or why it was refused."""
    rng = np.random.default_rng(seed)
    log = hopping(hops, rng)
    for change in changes:
        log = change(log, rng)
    write(log, folder, rng)
    settings = SectionSettings(
        height="height", phase="phase" if rule == "phase" else "", force=("force",) if rule == "force" else (),
        state=("speed=rate(forward)", "height"), command=("number",),
    )  # fmt: skip
    try:
        return score(log, extract_steps(str(folder / "log.csv"), folder / "plan.csv", settings))
    except RecordError as error:
        return str(error)


def summary(scores: Sequence[Score], hops: int) -> str:
    """One row of the table."""
    total = hops * len(scores)
    missed = total - sum(each.found for each in scores)
    extra, silent = sum(each.duplicated for each in scores), sum(each.silent for each in scores)
    errors = np.sqrt(np.mean(np.concatenate([each.errors for each in scores]) ** 2, axis=0))
    ratios = np.sqrt(np.mean(np.concatenate([each.standardised for each in scores]) ** 2, axis=0))
    cells = [
        f"{missed}, {extra} ({silent})",
        f"{sum(each.steps for each in scores)} of {total - len(scores)}",
        f"{sum(each.wrong for each in scores)}",
        f"{1e3 * errors[0]:.2f}, {1e3 * errors[1]:.3f}",
        f"{ratios[0]:.2f}, {ratios[1]:.2f}",
        f"{sum(each.refused for each in scores)}",
    ]
    return " | ".join(cells)


def main() -> None:
    """Prints a row for each case."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--hops", type=int, default=200)
    parser.add_argument("--seeds", default="41,42,43,44,45")
    parser.add_argument("--cases", default="")
    options = parser.parse_args()
    seeds = [int(seed) for seed in options.seeds.split(",")]
    print(
        "case | rule | missed, extra (without doubt) | steps of all | wrong | RMSE of speed, height [mm/s, mm] | "
        "RMS ratio of error to standard error | logs refused"
    )
    for name, changes in CASES.items():
        if options.cases not in name:
            continue
        for rule in ("height", "phase", "force"):
            with TemporaryDirectory() as folder:
                results = [trial(changes, rule, options.hops, seed, Path(folder)) for seed in seeds]
            scores = [each for each in results if isinstance(each, Score)]
            for text in {each for each in results if isinstance(each, str)}:
                print(f"  refused: {text[-150:]}")
            if not scores:
                continue
            print(f"{name} | {rule} | {summary(scores, options.hops)}", flush=True)


if __name__ == "__main__":
    main()
