"""A model is copied with all of its files, and one that would take all memory or time is refused by its text."""

import os
import shutil
from pathlib import Path
from xml.sax.saxutils import quoteattr

import pytest

from stepgap.base.errors import InputError
from stepgap.mujoco_robots.mjcf.model_files import MODEL_FILE, model_files
from stepgap.mujoco_robots.trial import parts_of_model

BODY = "<worldbody><body><geom size='0.1'/></body></worldbody>"
MESH = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n"
MESHED = "<geom type='mesh' mesh='{}'/>"


def written(folder: Path, texts: dict[str, str]) -> Path:
    """A folder with these files; returns the first one."""
    for name, text in texts.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    return folder / next(iter(texts))


def copied(main: Path, target: Path) -> Path:
    """The model in a new folder, with the original out of reach."""
    for name, content in model_files(main).items():
        (target / name).parent.mkdir(parents=True, exist_ok=True)
        if isinstance(content, Path):
            shutil.copyfile(content, target / name)
        else:
            (target / name).write_text(content)
    main.parent.rename(main.parent.with_name("gone"))
    return target / MODEL_FILE


def model(assets: str, geoms: str, compiler: str = "") -> str:
    body = f"<worldbody><body><joint name='j'/>{geoms}</body></worldbody>"
    return f"<mujoco>{compiler}<asset>{assets}</asset>{body}</mujoco>"


IN_PACKAGE = (
    "<robot name='r'><link name='base'><inertial><mass value='1'/><inertia ixx='1' iyy='1' "
    "izz='1' ixy='0' ixz='0' iyz='0'/></inertial><collision><geometry><mesh filename="
    "'package://my_robot/meshes/a.obj'/></geometry></collision></link></robot>"
)

FORMS = {
    "a mesh beside it": {"m.xml": model("<mesh file='a.obj'/>", MESHED.format("a")), "a.obj": MESH},
    "meshdir": {
        "m.xml": model("<mesh file='a.obj'/>", MESHED.format("a"), "<compiler meshdir='x/y'/>"),
        "x/y/a.obj": MESH,
    },
    "assetdir in an included file": {
        "m.xml": f"<mujoco><include file='sub/parts.xml'/><worldbody><body>{MESHED.format('a')}</body></worldbody>"
        "</mujoco>",
        "sub/parts.xml": "<mujoco><compiler assetdir='meshes'/><asset><mesh file='a.obj'/></asset></mujoco>",
        "meshes/a.obj": MESH,
    },
    "strippath": {
        "m.xml": model("<mesh file='no/where/a.obj'/>", MESHED.format("a"), "<compiler strippath='true'/>"),
        "a.obj": MESH,
    },
    "two files of one name": {
        "m.xml": model(
            "<mesh name='l' file='l/a.obj'/><mesh file='r/a.obj' scale='2 2 2'/>",
            MESHED.format("l") + MESHED.format("a"),
        ),
        "l/a.obj": MESH,
        "r/a.obj": MESH.replace("0 0 1", "0 0 3"),
    },
    "includes within includes": {
        "m.xml": f"<mujoco><!-- mine --><include file='1.xml'/>{BODY}</mujoco>",
        "1.xml": "<mujoco><option timestep='0.001'/><include file='2.xml'/></mujoco>",
        "2.xml": "<mujoco><option gravity='0 0 -1'/></mujoco>",
    },
    "a model in a model": {
        "m.xml": "<mujoco><asset><model name='m' file='arm/arm.xml'/></asset><worldbody><frame>"
        "<attach model='m' body='b' prefix='arm_'/></frame></worldbody></mujoco>",
        "arm/arm.xml": "<mujoco><compiler meshdir='parts'/><asset><mesh file='a.obj'/></asset>"
        f"<worldbody><body name='b'><joint/>{MESHED.format('a')}</body></worldbody></mujoco>",
        "arm/parts/a.obj": MESH,
    },
    "a URDF with packages": {
        "my_robot/urdf/r.urdf": IN_PACKAGE,
        "my_robot/meshes/a.obj": MESH,
    },
    "a URDF in a folder with another name than its package": {
        "robot/urdf/r.urdf": IN_PACKAGE,
        "robot/meshes/a.obj": MESH,
    },
    "assets beside the folder of the model": {
        "mjcf/m.xml": model("<mesh file='a.obj'/>", MESHED.format("a"), "<compiler meshdir='../meshes'/>"),
        "meshes/a.obj": MESH,
    },
    "a ROS package": {
        "r/models/deep/m.xml": model("<mesh file='../../bodies/a.obj'/>", MESHED.format("a")),
        "r/bodies/a.obj": MESH,
        "r/package.xml": "<package/>",
    },
}


@pytest.mark.parametrize("form", FORMS)
def test_the_copy_loads_without_the_original(form: str, tmp_path: Path) -> None:
    main = written(tmp_path / "original", FORMS[form])
    before = None if main.suffix == ".urdf" else parts_of_model(main)
    copy = copied(main, tmp_path / "copy")
    parts = parts_of_model(copy)
    assert before is None or before == parts
    assert parts.geoms


def test_what_is_missing_is_named_with_where_it_would_be(tmp_path: Path) -> None:
    main = written(tmp_path, {"m.xml": model("<mesh name='hull' file='a.obj'/>", "", "<compiler meshdir='x'/>")})
    with pytest.raises(
        InputError, match=r"m\.xml: <mesh hull>: there is no file 'a\.obj'; MuJoCo would look for .*x/a"
    ):
        model_files(main)


def asset(text: str) -> str:
    return f"<mujoco><asset>{text}</asset>{BODY}</mujoco>"


URDF = (
    "<robot name='r'><link name='base'><collision><geometry><mesh filename='{}'/></geometry></collision></link></robot>"
)
SUBINCLUDE = "<mujoco><include file='../../home/id.obj'/></mujoco>"


def placed(compiler: str) -> str:
    return model("<mesh file='id.obj'/>", "", f"<compiler {compiler}/>")


@pytest.mark.parametrize(
    ("texts", "words"),
    [
        ({"m.xml": asset("<mesh name='a' file='../home/id.obj'/>")}, "<mesh a file='../home/id.obj'>: this is HOME"),
        ({"m.xml": asset("<texture name='t' type='2d' file='HOME/id.obj'/>")}, "<texture t file='HOME/id.obj'>"),
        ({"m.xml": asset("<texture name='t' type='cube' fileup='../home/id.obj'/>")}, "<texture t fileup="),
        ({"m.xml": asset("<hfield file='../home/id.obj' size='1 1 1 1'/>")}, "<hfield file="),
        ({"m.xml": asset("<texture type='2d' file='/proc/self/environ'/>")}, "this is /proc/"),
        ({"m.xml": asset("<texture type='2d' file='/proc/kmsg'/>")}, "this is /proc/kmsg"),
        ({"m.xml": asset("<model name='x' file='../home/id.obj'/>")}, "<model x file="),
        ({"m.xml": placed("meshdir='../home'")}, "<mesh file='id.obj'>: this is HOME"),
        ({"m.xml": placed("assetdir='HOME'")}, "this is HOME/id.obj"),
        ({"m.xml": placed("texturedir='../home'").replace("<mesh", "<texture type='2d'")}, "this is HOME"),
        ({"m.xml": f"<mujoco><include file='../home/id.obj'/>{BODY}</mujoco>"}, "<include file='../home/id.obj'>"),
        (
            {"m.xml": "<mujoco><include file='sub/n.xml'/></mujoco>", "sub/n.xml": SUBINCLUDE},
            "<include file='../../home/id.obj'>: this is HOME/id.obj",
        ),
        ({"r.urdf": URDF.format("../home/id.obj")}, "<mesh filename='../home/id.obj'>"),
        ({"r.urdf": URDF.format("package://home/id.obj")}, "<mesh filename='package://home/id.obj'>: this is HOME"),
    ],
)  # fmt: skip
def test_a_file_that_does_not_lie_with_the_model_is_never_read(
    texts: dict[str, str], words: str, tmp_path: Path
) -> None:
    home = written(tmp_path / "home", {"id.obj": "secret"}).parent
    main = written(tmp_path / "model", {name: text.replace("HOME", str(home)) for name, text in texts.items()})
    with pytest.raises(InputError) as caught:
        model_files(main)
    message = str(caught.value)
    assert message.startswith(str(main))
    assert words.replace("HOME", str(home)) in message
    assert message.endswith(f"does not lie with the model, so it is not read; copy the file into {main.parent}")


def test_a_link_is_where_it_leads_to(tmp_path: Path) -> None:
    written(tmp_path / "home", {"id.obj": MESH})
    main = written(tmp_path / "model", {"m.xml": asset("<mesh file='meshes/id.obj'/>")})
    (main.parent / "meshes").symlink_to(tmp_path / "home")
    with pytest.raises(InputError, match=r"<mesh file='meshes/id\.obj'>: this is .*home/id\.obj, which does not lie"):
        model_files(main)
    (main.parent / "meshes").unlink()
    (tmp_path / "meshes").symlink_to(tmp_path / "home")
    main.write_text(asset("<mesh file='../meshes/id.obj'/>"))
    with pytest.raises(InputError, match="does not lie with the model"):
        model_files(main)
    shutil.copyfile(tmp_path / "home/id.obj", main.parent / "id.obj")
    assert model_files(main)["assets/id.obj"] == main.parent / "id.obj", "the remedy of the message"


def test_what_a_urdf_only_shows_is_left_out_where_it_lies_elsewhere(tmp_path: Path) -> None:
    written(tmp_path / "home", {"id.obj": "secret"})
    main = written(tmp_path / "model", {"r.urdf": URDF.format("../home/id.obj").replace("collision", "visual")})
    assert "id.obj" not in "".join(map(str, model_files(main).values()))


def test_a_pipe_is_no_file_of_a_model(tmp_path: Path) -> None:
    main = written(tmp_path, {"m.xml": f"<mujoco><include file='n.xml'/>{BODY}</mujoco>"})
    os.mkfifo(tmp_path / "n.xml")
    with pytest.raises(InputError, match=r"there is no file 'n\.xml'"):
        model_files(main)
    with pytest.raises(InputError, match="a pipe or a device"):
        model_files(tmp_path / "n.xml")


def test_included_texts_are_bounded_together(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("stepgap.mujoco_robots.mjcf.model_files.LARGEST_XML", 100)
    main = written(tmp_path, {"m.xml": f"<mujoco>{include(1)}</mujoco>", "1.xml": f"<mujoco>{' ' * 60}</mujoco>"})
    with pytest.raises(InputError, match=r"1\.xml: with it the XML files are larger than 100 bytes together"):
        model_files(main)


NAME = "a'b"
GEOM, REPEATED = "<geom size='1'/>", "<replicate count='2000'>"


def geoms(count: int) -> str:
    return f"<mujoco><worldbody>{GEOM * count}</worldbody></mujoco>"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (f"<mujoco><asset><hfield nrow='60000' ncol='60000'/></asset>{BODY}</mujoco>", "3600000000 points"),
        (f"<mujoco><asset><texture width='1e5' height='100000'/></asset>{BODY}</mujoco>", "10000000000 points"),
        (f"<mujoco><worldbody><replicate count='2000000'>{BODY}</replicate></worldbody></mujoco>", "2000002 elements"),
        (f"<mujoco>{2 * REPEATED}{BODY}{2 * '</replicate>'}</mujoco>", "elements, of at most"),
        ("<mujoco><worldbody><flexcomp count='300 300 300'/></worldbody></mujoco>", "27000002 elements"),
        ("<mujoco><worldbody><composite count='100000 1 1'/></worldbody></mujoco>", "elements"),
        (geoms(60_000), "50001 elements, of at most 50000"),
        (f"<mujoco>{'<body>' * 300}{'</body>' * 300}</mujoco>", "nested more than 200 deep"),
        (f"<mujoco><include file='m.xml'/>{BODY}</mujoco>", "it includes itself"),
        ("<!DOCTYPE m [<!ENTITY a 'b'>]><mujoco/>", "has entities"),
        ("nonsense", "syntax error: line 1, column 0; give a MuJoCo model"),
        ("", "no element found"),
        ("<mujoco><asset><mesh file='/dev/zero'/></asset></mujoco>", "there is no file '/dev/zero'"),
        (f"<mujoco><asset><mesh file='{'a' * 5000}'/></asset></mujoco>", "there is no file 'aaa"),
    ],
)
def test_a_model_that_would_never_load_is_refused_by_its_text(text: str, message: str, tmp_path: Path) -> None:
    main = written(tmp_path, {"m.xml": text})
    with pytest.raises(InputError, match=message) as caught:
        model_files(main)
    assert str(caught.value).startswith(str(main))
    assert len(str(caught.value)) < 500


def include(number: int) -> str:
    return f"<include file='{number}.xml'/>"


def test_files_that_include_others_twice_come_to_an_end(tmp_path: Path) -> None:
    twice = {f"{k}.xml": f"<mujoco>{2 * include(k + 1)}</mujoco>" for k in range(30)}
    main = written(tmp_path, {**twice, "30.xml": "<mujoco/>"})
    with pytest.raises(InputError, match="more than 10000 files"):
        model_files(main)


def test_what_ends_mujoco_ends_only_its_process(tmp_path: Path) -> None:
    named = BODY.replace("<body>", "<body name='b'>")
    asset, attach = "<asset><model name='m' file='m.xml'/></asset>", "<attach model='m' body='b' prefix='x'/>"
    itself = f"<mujoco>{asset}{named}<worldbody>{attach}</worldbody></mujoco>"
    with pytest.raises(ValueError, match=r"ends while it loads|rror"):
        parts_of_model(written(tmp_path, {"m.xml": itself}))
    with pytest.raises(ValueError, match="memory"):
        parts_of_model(written(tmp_path, {"n.xml": f"<mujoco><size memory='900G'/>{BODY}</mujoco>"}))
    jointed = geoms(20_000).replace(GEOM, f"<body><joint/>{GEOM}</body>")
    with pytest.raises(ValueError, match=r"more than 1 s|within 5 s"):
        parts_of_model(written(tmp_path, {"s.xml": jointed}), seconds=1)


def test_parts_without_names_have_numbers(tmp_path: Path) -> None:
    inner = "<body><joint name='k'/><geom size='1' contype='0' conaffinity='0'/></body>"
    free = f"<body name={quoteattr(NAME)} pos='0 0 0.4'><freejoint/>{GEOM}{inner}</body>"
    floor = "<geom name='floor' type='plane' size='1 1 1'/>"
    parts = parts_of_model(written(tmp_path, {"m.xml": f"<mujoco><worldbody>{floor}{free}</worldbody></mujoco>"}))
    assert parts.geoms == {"world": ["floor"], NAME: [1], 2: [2]}
    assert (parts.joints, parts.touching) == (["", "k"], [1])
    assert parts.coordinates == {"height": 2, "rise": 2, "speed": 0}
    assert parts.start[2] == 0.4


def test_a_mesh_that_git_lfs_did_not_fetch(tmp_path: Path) -> None:
    """MuJoCo would say that it has too few vertices."""
    unfetched = "version https://git-lfs.example/spec/v1\noid sha256:0\nsize 7\n"
    main = written(tmp_path, {"m.xml": model("<mesh file='a.obj'/>", MESHED.format("a")), "a.obj": unfetched})
    with pytest.raises(InputError, match=r"m\.xml: .*a\.obj: not the file, but what Git LFS has in its place"):
        model_files(main)
