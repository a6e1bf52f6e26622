"""The exported C code trusts the map that Python trusts, with its disturbance, step by step of a changing robot."""

import re
import subprocess
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from stepgap.export.controller.c_source import Real, c_source
from stepgap.export.controller.portable_controller import PortableController
from stepgap.learning.trust import MOST_STRAINED, Trust
from stepgap.step import Array
from tests.export.controller.changing_robot import ChangingStep, changing_steps
from tests.export.controller.learned import SPACE, learned
from tests.export.controller.test_c_source import COMPILER, TOLERANCE, Compiled
from tests.export.controller.test_c_source import compile_in as compile_in  # fixture

pytestmark = pytest.mark.skipif(COMPILER is None, reason="there is no C compiler")

NO_STEP = np.zeros(4)
CASES = {
    "all": ("gp", {}),
    "polynomial": ("quadratic", {}),
    "every error counts": ("gp", {"reject_outliers": False}),
    "no disturbance": ("gp", {"drift": False}),
    "never the nominal map": ("gp_on_linear", {"monitor": False}),
    "no residual": ("none", {"drift": False, "monitor": False}),
}
EXPECTED = {
    "all": {"changed", "earlier", "outlier", "strained"},
    "polynomial": {"changed", "earlier", "outlier", "strained"},
    "every error counts": {"changed", "earlier", "strained"},
    "no disturbance": {"nominal", "earlier", "outlier", "strained"},
    "never the nominal map": {"changed", "earlier", "outlier"},
    "no residual": set(),
}
"""What happens in each case."""


def events(before: Trust, after: Trust) -> set[str]:
    """What has happened at a step."""
    strained = after.strained >= MOST_STRAINED > before.strained
    return {*filter(None, [after.alarm, "outlier" * after.outlier, "strained" * strained])}


def update(code: Compiled, step: ChangingStep) -> int:
    record = step.record
    given = map(code.array, (record.state, record.requested, record.next_state))
    return code.call("filter_update", code.filter, *given, step.phase)


def apart(code: Compiled, controller: PortableController, trust: Trust, rng: np.random.Generator) -> float:
    """Largest difference of the disturbance at the middle, and of the map at the command of a plan [half ranges]."""
    yaw = float(rng.uniform(-9, 9)) if rng.uniform() < 0.8 else float("nan")
    disturbance = trust.predict(controller.map.residual, yaw)
    offset, spread = code.array(2), code.array(2)
    code.call("filter_offset", code.filter, yaw, offset, spread)
    step_map = controller.map_by(trust, yaw)
    state, target = SPACE.state_centre + SPACE.state_scale * rng.uniform(-0.7, 0.7, (2, 2))
    status, command, predicted, std = code.plan(state, target, None, yaw)
    assert status == 0
    pairs: list[tuple[Array, Array]] = [
        (offset, disturbance.mean(NO_STEP)),
        (spread, disturbance.std(NO_STEP)),
        (predicted, step_map(state, command)),
        (std, np.hypot(step_map.std(state, command), step_map.noise_std)),
    ]
    return max(float(np.abs((found - expected) / SPACE.state_scale).max()) for found, expected in pairs)


@pytest.mark.parametrize(("case", "real"), [*((case, "double") for case in CASES), ("all", "float")])
def test_it_trusts_what_python_trusts(case: str, real: Real, compile_in: Callable[..., Compiled]) -> None:
    kind, options = CASES[case]
    controller = replace(learned(kind), **{"reject_outliers": True, **options})
    code, rng, happened = compile_in(controller, real), np.random.default_rng(1), set[str]()
    trust = controller.trust
    for step in changing_steps(controller):
        assert apart(code, controller, trust, rng) < TOLERANCE[real]
        before, trust = trust, controller.trust_after(trust, step.record, step.phase)
        happened |= events(before, trust)
        assert update(code, step) == 0
    assert happened == EXPECTED[case]


def test_after_a_warm_start_another_robot_is_recognised_at_the_first_step(compile_in: Callable[..., Compiled]) -> None:
    controller = replace(learned("gp"), reject_outliers=True, warm_start=True)
    code, trust = compile_in(controller), controller.trust
    first = changing_steps(controller, (("loaded", 1),))[0]
    trust = controller.trust_after(trust, first.record, first.phase)
    assert update(code, first) == 0
    assert trust.alarm == "changed"
    assert apart(code, controller, trust, np.random.default_rng(4)) < 1e-9


def test_after_a_change_plans_are_those_of_python(compile_in: Callable[..., Compiled]) -> None:
    """Where the disturbance depends on state and command, so do the derivatives with which a plan is found."""
    controller = replace(learned("gp_on_linear"), reject_outliers=True)
    controller = replace(controller, settings=replace(controller.settings, horizon=2))
    code, rng, same, trust = compile_in(controller), np.random.default_rng(2), 0, controller.trust
    for step in changing_steps(controller)[:80]:
        trust = controller.trust_after(trust, step.record, step.phase)
        assert update(code, step) == 0
    assert trust.hypotheses[0].filter.changed
    assert trust.uses_residual
    step_map = controller.map_by(trust, 0.3)
    python = replace(controller.controller, step_map=step_map)
    for _ in range(20):
        state, *targets = SPACE.state_centre + SPACE.state_scale * rng.uniform(-1, 1, (3, 2))
        plan = python(state, targets[0], None, np.array(targets[1:]))
        status, command, predicted, _ = code.plan(state, np.array(targets), None, 0.3)
        assert status == 0
        np.testing.assert_allclose(predicted, step_map(state, command), atol=1e-9)
        same += bool(np.abs((command - plan.command) / SPACE.command_scale).max() < 1e-6)
    assert same >= 19, "another way by rounding is rare"


@pytest.mark.parametrize("bad", [np.nan, np.inf, 1e300])
def test_a_step_that_is_no_number_changes_nothing(bad: float, compile_in: Callable[..., Compiled]) -> None:
    controller = replace(learned("gp"), reject_outliers=True)
    code = compile_in(controller)
    first, last = changing_steps(controller)[:2]
    assert update(code, first) == 0
    trust = controller.trust_after(controller.trust, first.record, first.phase)
    for name in ("state", "requested", "next_state"):
        record = replace(last.record, **{name: np.array([bad, getattr(last.record, name)[1]])})
        assert update(code, replace(last, record=record)) != 0
        assert apart(code, controller, trust, np.random.default_rng(3)) < 1e-9


@pytest.mark.parametrize("real", ["double", "float"])
def test_the_header_says_how_large_its_state_is(real: Real, tmp_path: Path) -> None:
    source = c_source(learned("gp"), "controller", real)
    (tmp_path / "controller.h").write_text(source.header)
    (tmp_path / "size.c").write_text(
        '#include <stdio.h>\n#include "controller.h"\n'
        'int main(void) { printf("%d", (int)sizeof(controller_filter)); return 0; }\n'
    )
    subprocess.run([str(COMPILER), "size.c", "-o", "size"], cwd=tmp_path, check=True)
    size = int(subprocess.run([tmp_path / "size"], capture_output=True, text=True, check=True).stdout)
    (stated,) = re.findall(r"about (\d+) kB: the hypotheses", source.header)
    assert 1000 * int(stated) == pytest.approx(size, abs=1000)
