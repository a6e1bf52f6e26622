"""A limit cycle and its one-step reachable set, as text and as a figure, for `stepgap gait`."""

import numpy as np
from matplotlib.figure import Figure

from stepgap.control.limit_cycle import FixedPoint, ReachableSet
from stepgap.control.reach import SMALL_PART, command_effect
from stepgap.records.text import decimal, in_scale, in_words, unit_suffix
from stepgap.report.drawing import axis_label
from stepgap.report.gait_text import HALF_RANGES, effect_sentences
from stepgap.step import StepMap, StepSpace, StepStatus


def describe_gait(step_map: StepMap, point: FixedPoint, reachable: ReachableSet) -> str:
    """A few lines on a limit cycle, the effect of the commands there, and the reachable set, for the terminal."""
    space = step_map.space
    lines = [
        f"state X0             {in_words(space.state, point.state)}",
        f"command U0           {in_words(space.command, point.command)}",
    ]
    if not np.isfinite(point.floquet_multipliers).all():
        lines.append("Floquet multipliers  unknown: a step nearby fails, so the map has no derivative here")
    elif point.held:
        sizes = ", ".join(decimal(abs(multiplier)) for multiplier in point.floquet_multipliers)
        verdict = "stable" if point.stable else "not stable"
        lines.append(f"Floquet multipliers  |λ| = {sizes}: {verdict} at a constant command")
    if not point.held:
        closest = in_words(space.state, point.next_state)
        lines.append(f"not held             within the command bounds; the closest next state is {closest}")
    failed = reachable.statuses != StepStatus.OK
    if failed.all():
        lines.append("reachable            no state: every command fails from this state")
    else:
        next_states = reachable.next_states.reshape(-1, len(space.state))
        low = np.nanmin(next_states, axis=0)
        high = np.nanmax(next_states, axis=0)
        ranges = ", ".join(
            f"{q.name} {in_scale(a, q)} … {in_scale(b, q)}{unit_suffix(q)}"
            for q, a, b in zip(space.state, low, high, strict=True)
        )
        lines.append(
            f"reachable            in one step: {ranges}"
            + (f"; {failed.mean():.0%} of the commands fail" if failed.any() else "")
        )
    jacobian = step_map.jacobian(point.state, point.command)
    if np.isfinite(jacobian).all():
        effect = command_effect(space, jacobian, SMALL_PART * space.state_scale)
        sentences = effect_sentences(space, effect, "the map", HALF_RANGES)
        first, *others = (sentence.removeprefix("By the map, ") for sentence in sentences)
        lines += [f"{'commands':21}{first.removeprefix('the commands ')}", *(f"{'':21}{other}" for other in others)]
    return "\n".join(lines)


def gait_figure(space: StepSpace, point: FixedPoint, reachable: ReachableSet) -> Figure:
    """Draws the reachable set, and the Floquet multipliers in the complex plane.

    Of the state, the first two coordinates are shown; if there is only one, it is shown against the first command.
    """
    figure = Figure(figsize=(10, 4.5), layout="constrained")
    plane, circle = figure.subplots(1, 2, width_ratios=[1.5, 1])
    states = reachable.next_states.reshape(-1, len(space.state))
    commands = reachable.commands.reshape(-1, len(space.command))
    if len(space.state) > 1:
        shown = states
        here = point.state
        nearest = point.next_state
        labels = [f"next {axis_label(quantity, capital=False)}" for quantity in space.state[:2]]
    else:
        shown = np.hstack([commands[:, :1], states])
        first = point.command.tolist()[0]
        here, nearest = (np.array([first, *state]) for state in (point.state, point.next_state))
        labels = [
            axis_label(space.command[0], capital=False),
            f"next {axis_label(next(iter(space.state)), capital=False)}",
        ]
    if len(space.command) == 2 and len(space.state) > 1:
        border = reachable.boundary
        plane.fill(border[:, 0], border[:, 1], color="0.92", zorder=0)
        plane.plot(*np.vstack([border, border[:1]]).T[:2], color="0.4", lw=1.2, label="commands on their bounds")
    plane.plot(shown[:, 0], shown[:, 1], ".", ms=2, color="0.6", label="one step, commands on a grid")
    plane.plot(*here[:2], "o", ms=8, color="#0072B2", label="state $X_0$")
    if not point.held:
        plane.plot(*nearest[:2], "x", ms=9, mew=2, color="#D55E00", label="closest next state")
    plane.set(xlabel=labels[0], ylabel=labels[1], title="One-step reachable set")
    figure.legend(loc="outside lower center", ncols=4, fontsize=9, frameon=False)
    angle = np.linspace(0, 2 * np.pi, 200)
    circle.plot(np.cos(angle), np.sin(angle), color="0.4", lw=1)
    circle.axhline(0, color="0.85", lw=0.8, zorder=0)
    circle.axvline(0, color="0.85", lw=0.8, zorder=0)
    circle.plot(point.floquet_multipliers.real, point.floquet_multipliers.imag, "s", ms=7, color="#0072B2")
    verdict = "not held"
    if point.held:
        verdict = "stable" if point.stable else "not stable"
    circle.set(aspect="equal", xlabel="real part", ylabel="imaginary part", title=f"Floquet multipliers ({verdict})")
    return figure
