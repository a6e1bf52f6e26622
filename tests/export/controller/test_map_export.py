"""ONNX and CasADi compute the map that Python computes, inside and outside of the ranges."""

import json

import numpy as np
import pytest

from stepgap.export.controller.casadi_function import casadi_function, casadi_text
from stepgap.export.controller.model_document import model_document
from stepgap.export.controller.onnx_model import onnx_model
from stepgap.step import difference_jacobian
from tests.export.controller.learned import KINDS, SPACE, learned, steps

NOMINALS = pytest.mark.parametrize("linear", [False, True], ids=["legendre", "affine"])


@NOMINALS
@pytest.mark.parametrize("kind", KINDS)
def test_onnx_computes_the_same_map(kind: str, linear: bool) -> None:
    pytest.importorskip("onnx", reason="the extra onnx is not installed")
    runtime = pytest.importorskip("onnxruntime", reason="onnxruntime is not installed")
    controller = learned(kind, failing=True, linear=linear)
    session = runtime.InferenceSession(onnx_model(model_document(controller)), providers=["CPUExecutionProvider"])
    state, command = steps(500, spread=3.0)
    state[7, 0], command[9, 1] = np.nan, np.inf
    expected = controller.map.evaluate(state, command)
    next_state, std, status = session.run(None, {"state": state, "command": command})
    assert np.array_equal(status, expected.status)
    assert linear or len(set(status)) == 4, "some steps fail"
    assert np.allclose(next_state, expected.next_state, rtol=0, atol=1e-10, equal_nan=True)
    assert np.allclose(std, controller.map.std(state, command), rtol=0, atol=1e-10, equal_nan=True)
    (alone, *_) = session.run(None, {"state": state[:1], "command": command[:1]})
    assert np.allclose(alone, next_state[:1], rtol=0, atol=1e-12, equal_nan=True)


def test_onnx_has_names_and_units() -> None:
    onnx = pytest.importorskip("onnx", reason="the extra onnx is not installed")
    model = onnx.load_model_from_string(onnx_model(model_document(learned("gp"))))
    found = {each.key: each.value for each in model.metadata_props}
    assert [(each["name"], each["unit"]) for each in json.loads(found["state"])] == [("speed", "m/s"), ("height", "m")]
    assert json.loads(found["command"])[1]["upper"] == SPACE.command[1].upper


@NOMINALS
@pytest.mark.parametrize("kind", KINDS)
def test_casadi_computes_the_same_map_and_its_derivatives(kind: str, linear: bool) -> None:
    casadi = pytest.importorskip("casadi", reason="the extra casadi is not installed")
    controller = learned(kind, linear=linear)
    function = casadi.Function.deserialize(casadi_text(model_document(controller)))
    jacobian = function.jacobian()
    for spread in (1.2, 3.0):
        for state, command in zip(*steps(15, spread=spread), strict=True):
            next_state, std = (np.array(each)[:, 0] for each in function(state, command))
            assert np.abs(next_state - controller.map(state, command)).max() < 1e-10
            assert np.abs(std - controller.map.std(state, command)).max() < 1e-10
            parts = [np.array(each) for each in jacobian(state, command, next_state, std)]
            found, by_std = np.hstack(parts[:2]), np.hstack(parts[2:])
            # Outside of the sampled range `jacobian` leaves a small term out, so differences are compared there.
            exact = controller.map.jacobian(state, command) if spread < 1.25 else None
            differences = difference_jacobian(controller.map, state, command)
            assert np.abs(found - (differences if exact is None else exact)).max() < (1e-5 if exact is None else 1e-9)
            assert np.abs(by_std - controller.map.std_gradient(state, command)).max() < 1e-8


def test_casadi_differentiates_at_a_centre_of_the_kernel() -> None:
    pytest.importorskip("casadi", reason="the extra casadi is not installed")
    controller = learned("gp")
    point = np.array(model_document(controller)["residual"]["regressions"][0]["centres"][0])
    function = casadi_function(model_document(controller))
    parts = function.jacobian()(point[:2], point[2:], 0, 0)
    expected = controller.map.jacobian(point[:2], point[2:])
    assert np.abs(np.hstack([np.array(each) for each in parts[:2]]) - expected).max() < 1e-9
