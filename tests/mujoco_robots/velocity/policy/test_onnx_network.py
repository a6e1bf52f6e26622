"""A network is computed as NumPy does, and a file that is no such network is refused, also in another process."""

import os
from copy import deepcopy
from pathlib import Path

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper

from stepgap.base.errors import InputError, StepGapError
from stepgap.mujoco_robots.trial import parts_of_network
from stepgap.mujoco_robots.velocity.policy import onnx_file
from stepgap.mujoco_robots.velocity.policy.onnx_file import read_network
from stepgap.mujoco_robots.velocity.policy.onnx_network import OnnxNetwork
from tests.mujoco_robots.velocity.policy.networks import write_network

WEIGHTS = np.random.default_rng(0).normal(size=(2, 3))


def graph(
    path: Path, operator: str = "Abs", shapes: tuple[tuple[int | str, ...], ...] = ((1, 3),), **node: str
) -> Path:
    """Writes a network of one operator with an input of each shape, and an output of the first one."""
    names = [f"x{number}" for number in range(len(shapes))]
    inputs = [
        helper.make_tensor_value_info(*each) for each in zip(names, [TensorProto.FLOAT] * 9, shapes, strict=False)
    ]
    output = helper.make_tensor_value_info("y", TensorProto.FLOAT, shapes[0])
    made = helper.make_graph([helper.make_node(operator, names, ["y"], **node)], "g", inputs, [output])
    onnx.save(helper.make_model(made, opset_imports=[helper.make_opsetid("", 17)], ir_version=8), path)
    return path


@pytest.mark.parametrize("rank", [1, 2])
def test_its_output_is_that_of_numpy(tmp_path: Path, rank: int) -> None:
    network = OnnxNetwork(write_network(tmp_path / "p.onnx", WEIGHTS, {"joint_names": "a,b"}, rank))
    assert (network.input_size, network.output_size, network.metadata) == (3, 2, {"joint_names": "a,b"})
    values = np.array([0.1, -2.0, 3.0])
    np.testing.assert_allclose(network(values), WEIGHTS @ values, atol=1e-6)
    assert deepcopy(network) is network, "it has no memory that a copy of a robot needs"


def test_any_batch_size_is_accepted(tmp_path: Path) -> None:
    assert OnnxNetwork(graph(tmp_path / "p.onnx", shapes=(("batch", 3),)))(
        np.array([-1.0, 2.0, -3.0])
    ) == pytest.approx([1, 2, 3])


def test_the_trial_in_another_process_says_the_same(tmp_path: Path) -> None:
    parts = parts_of_network(write_network(tmp_path / "p.onnx", WEIGHTS, {"action_scale": "0.5"}))
    assert parts == (3, 2, {"action_scale": "0.5"}, ["obs", "actions"])
    (tmp_path / "bad.onnx").write_bytes(b"\x08\x07")
    with pytest.raises(ValueError, match=r"bad.onnx: onnxruntime cannot load it: .*; export the policy") as found:
        parts_of_network(tmp_path / "bad.onnx")
    assert str(found.value).count("bad.onnx") == 1


def external(path: Path, location: str = "data") -> Path:
    """A network whose numbers are in a file beside it, which gets another location afterwards."""
    model = onnx.load(write_network(path, WEIGHTS))
    onnx.save(model, path, save_as_external_data=True, location="data", size_threshold=0)
    model = onnx.load(path, load_external_data=False)
    for entry in model.graph.initializer[0].external_data:
        if entry.key == "location":
            entry.value = location
    path.write_bytes(model.SerializeToString())
    return path


def in_a_subgraph(path: Path) -> Path:
    """A network with the same numbers in a constant within a branch, in a file in a folder beside it."""
    onnx.save(onnx.load(external(path)), path)
    network = onnx.load(path)
    weights = network.graph.initializer.pop()
    weights.name = "w"
    branch = helper.make_graph(
        [helper.make_node("Constant", [], ["w"], value=weights)],
        "branch",
        [],
        [helper.make_tensor_value_info("w", TensorProto.FLOAT, [3, 2])],
    )
    yes = helper.make_node("Constant", [], ["yes"], value=helper.make_tensor("yes", TensorProto.BOOL, [], [True]))
    choose = helper.make_node("If", ["yes"], ["weights"], then_branch=branch, else_branch=branch)
    product = network.graph.node.pop()
    network.graph.node.extend([yes, choose, product])
    numbers = weights.raw_data
    for entry in network.graph.node[1].attribute:
        tensor = entry.g.node[0].attribute[0].t
        tensor.ClearField("raw_data")
        tensor.data_location = TensorProto.EXTERNAL
        for key, value in {"location": "numbers/w", "offset": "8", "length": str(len(numbers))}.items():
            tensor.external_data.add(key=key, value=value)
    (path.parent / "numbers").mkdir()
    (path.parent / "numbers/w").write_bytes(b"padding." + numbers)
    path.write_bytes(network.SerializeToString())
    return path


@pytest.mark.parametrize("make", [external, in_a_subgraph])
def test_numbers_beside_a_network_belong_to_it(tmp_path: Path, make, monkeypatch: pytest.MonkeyPatch) -> None:
    path = make(tmp_path / "p.onnx")
    monkeypatch.chdir(tmp_path.parent)
    values = np.array([0.1, -2.0, 3.0])
    np.testing.assert_allclose(OnnxNetwork(path)(values), WEIGHTS @ values, atol=1e-6)
    assert parts_of_network(path).inputs == 3
    whole = tmp_path / "elsewhere/one_file.onnx"
    whole.parent.mkdir()
    whole.write_bytes(read_network(path))
    onnx.checker.check_model(onnx.load(whole))
    np.testing.assert_allclose(OnnxNetwork(whole)(values), WEIGHTS @ values, atol=1e-6)


@pytest.mark.parametrize("location", ["../home/id", "HOME/id", "link", "links/id", "/proc/self/environ"])
def test_numbers_elsewhere_are_never_read(tmp_path: Path, location: str) -> None:
    home = tmp_path / "home"
    home.mkdir()
    (home / "id").write_bytes(b"secret..." * 100)
    folder = tmp_path / "policy"
    folder.mkdir()
    path = external(folder / "p.onnx", location.replace("HOME", str(home)))
    (folder / "link").symlink_to(home / "id")
    (folder / "links").symlink_to(home)
    with pytest.raises(
        InputError, match=r"p\.onnx: some of its numbers are in another file, '.*', which does not lie"
    ) as found:
        OnnxNetwork(path)
    assert str(found.value).endswith("onnx.save(onnx.load('p.onnx'), 'one_file.onnx')")


@pytest.mark.parametrize("location", ["gone.data", "", "a" * 5000, "nul\0", "pipe"])
def test_numbers_that_are_missing_are_named(tmp_path: Path, location: str) -> None:
    path = external(tmp_path / "p.onnx", location)
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(InputError, match=r"which is not beside it; copy it there, too, or where both are, save them"):
        OnnxNetwork(path)


def test_numbers_that_are_cut_off_or_too_many_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = external(tmp_path / "p.onnx")
    (tmp_path / "data").write_bytes(b"1234")
    with pytest.raises(InputError, match=r"its numbers are in 'data', which is shorter than they are; copy"):
        OnnxNetwork(path)
    path = external(path)
    monkeypatch.setattr(onnx_file, "LARGEST_NETWORK", path.stat().st_size)
    (tmp_path / "data").write_bytes(bytes(path.stat().st_size + 1))
    with pytest.raises(InputError, match="data: larger than"):
        OnnxNetwork(path)


def test_a_file_of_pytorch_is_refused_with_the_lines_that_convert_it(tmp_path: Path) -> None:
    (tmp_path / "walk.pt").write_bytes(b"PK\x03\x04 walk/code/")
    lines = (
        r"import torch; policy = torch\.jit\.load\('walk\.pt'\)\.eval\(\); torch\.onnx\.export\(policy, .*'walk\.onnx'"
    )
    with pytest.raises(InputError, match=lines):
        OnnxNetwork(tmp_path / "walk.pt")


@pytest.mark.parametrize(
    "content", [b"location\xff", b"\x3a\x7flocation", b"\x8a\x80\x80\x80\x10\x08location", b"\x3blocation"]
)
def test_what_is_no_onnx_file_is_named(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "p.onnx").write_bytes(content)
    with pytest.raises(InputError, match=r"p\.onnx: it is no ONNX file, or damaged; export the policy"):
        OnnxNetwork(tmp_path / "p.onnx")


@pytest.mark.parametrize("name", [b"obs", b"actions", b"the_key", b"the_text", b"MatMul"])
def test_a_name_that_is_not_utf_8_is_named(tmp_path: Path, name: bytes, capfd: pytest.CaptureFixture[str]) -> None:
    path = write_network(tmp_path / "p.onnx", WEIGHTS, {"the_key": "the_text"})
    path.write_bytes(path.read_bytes().replace(name, b"\xff" + name[1:]))
    for read in (OnnxNetwork, parts_of_network):
        with pytest.raises(ValueError, match=r"p\.onnx: .*\\xff") as found:
            read(path)
        assert "codec" not in str(found.value)
    assert capfd.readouterr().out == ""


def external_in_long_form(path: Path) -> Path:
    """The same, with a length of the key in two bytes instead of one: onnxruntime would read the other file."""

    def part(field: int, content: bytes) -> bytes:
        return bytes([8 * field + 2, len(content)]) + content

    model = onnx.load(graph(path, "Add", ((1, 3),)))
    model.graph.node[0].input.append("w")
    entries = b"\x0a\x88\x00location" + part(2, b"data"), part(1, b"length") + part(2, b"12")
    tensor = b"\x08\x03\x10\x01" + part(8, b"w") + b"".join(part(13, each) for each in entries) + b"\x70\x01"
    content = model.graph.SerializeToString() + part(5, tensor)
    model.ClearField("graph")
    path.write_bytes(model.SerializeToString() + part(7, content))
    assert onnx.load(path, load_external_data=False).graph.initializer[0].external_data[0].key == "location"
    return path


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (external_in_long_form, "some of its numbers are in another file"),
        (lambda path: graph(path, "Add", ((1, 3), (1, 3))), "it has 2 inputs (x0, x1), but only one can be given"),
        (
            lambda path: graph(path, shapes=((4, 3),)),
            "its input x0 is tensor(float) [4, 3], but it must be tensor(float)",
        ),
        (lambda path: graph(path, shapes=((1, "n"),)), "its input x0 is tensor(float) [1, 'n'], but it must be"),
        (lambda path: graph(path, shapes=((1, 2, 3),)), "its input x0 is tensor(float) [1, 2, 3], but"),
        (lambda path: graph(path, "Abs", domain="com.evil"), "onnxruntime cannot load it"),
        (lambda path: path, "No such file or directory"),
        (lambda path: path.parent, "Is a directory"),
    ],
)
def test_what_is_no_such_network_is_refused(tmp_path: Path, make, words: str) -> None:
    path = make(tmp_path / "p.onnx")
    with pytest.raises(InputError) as found:
        OnnxNetwork(path)
    assert str(found.value).startswith(str(path))
    assert words in str(found.value)


def test_a_large_file_is_not_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write_network(tmp_path / "p.onnx", WEIGHTS)
    monkeypatch.setattr(onnx_file, "LARGEST_NETWORK", path.stat().st_size - 1)
    with pytest.raises(InputError, match="larger than"):
        OnnxNetwork(path)


def test_an_output_that_is_no_number_is_never_given(tmp_path: Path) -> None:
    network = OnnxNetwork(graph(tmp_path / "p.onnx", "Sqrt"))
    assert network(np.ones(3)).tolist() == [1.0, 1.0, 1.0]
    with pytest.raises(StepGapError, match=r"p.onnx: its output is not 3 finite numbers"):
        network(-np.ones(3))
