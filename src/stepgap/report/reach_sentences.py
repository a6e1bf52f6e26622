"""What commands can do, in sentences: independent directions, delays, and changes of the target in one step."""

import numpy as np

from stepgap.control.reach import CommandEffect
from stepgap.records.text import capitalised, decimal, in_words, listed
from stepgap.report.reference_gait import MapGait, ReferenceGait
from stepgap.step import StepSpace


def reach_sentences(gait: ReferenceGait) -> list[str]:
    """Sentences on the commands by the last map, which is the corrected one if there is one."""
    last = gait.maps[-1]
    unit = "noise floors" if gait.has_floor else "hundredths of half the ranges of use"
    found = [] if last.effect is None else effect_sentences(gait.space, last.effect, f"the {last.name} map", unit)
    return [*found, *_changes(gait, last)]


def effect_sentences(space: StepSpace, effect: CommandEffect, by_map: str, unit: str) -> list[str]:
    """Sentences on the rank of the commands' effect, and on their delays.

    Args:
        space: State and command.
        effect: The effect.
        by_map: The map, in the middle of a sentence.
        unit: The unit of the effect, in the plural.
    """
    n = len(space.state)
    rank = effect.rank
    tracked = [quantity.name for quantity in space.state if quantity.weight]
    sizes = listed([decimal(size, 2) for size in effect.sizes])
    directions = f"{rank or 'no'} independent direction{'' if rank == 1 else 's'}"
    few = (
        f". So one step does not reach every combination of {listed(tracked)}, even if it reaches each one"
        if rank < len(tracked)
        else ""
    )
    found = [
        f"By {by_map}, the commands move the next state in {directions} (singular values from one end of their bounds "
        f"to the other: {sizes} {unit}){few}."
    ]
    late = {steps: [] for steps in sorted(set(effect.delays.tolist()) - {1})}
    for name, steps in zip(space.state_names, effect.delays.tolist(), strict=True):
        if steps != 1:
            late[steps].append(name)
    for steps, names in late.items():
        verb = "moves" if len(names) == 1 else "move"
        found.append(
            f"By {by_map}, no command moves {listed(names, 'or')} within {n} step{'s' * (n > 1)}."
            if steps == 0
            else f"By {by_map}, {listed(names)} {verb} only {steps} steps after a command begins."
        )
    return found


def _changes(gait: ReferenceGait, last: MapGait) -> list[str]:
    """Sentence on the changes of the target that one step can make."""
    count = len(gait.changes)
    reached = int(np.count_nonzero(last.changes))
    if not count:
        return []
    if reached == count:
        which = "the change" if count == 1 else f"each of the {count} changes"
        return [f"By the {last.name} map, one step can make {which} of the target."]
    before, after = (in_words(gait.space.state, target) for target in gait.changes[np.argmin(last.changes)])
    return [
        capitalised(
            f"by the {last.name} map, one step can make {reached or 'none'} of the {count} changes of the target, for "
            f"example not that from {before} to {after}: such changes take several steps, or cannot be made."
        )
    ]
