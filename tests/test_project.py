"""What the files around the code promise: a lock that holds, no registry named, commands that exist."""

import os
import re
import shlex
import shutil
import subprocess
import sys
import tomllib
from inspect import signature
from pathlib import Path

import pytest
import yaml
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from stepgap.base import compiled
from stepgap.cli.verbs import GROUPS

ROOT = Path(__file__).parents[1]
PYPROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
LOCKS = {name: (ROOT / name).read_text(encoding="utf-8") for name in ("requirements.lock", "requirements-dev.lock")}
FOR_USERS = PYPROJECT["project"]["dependencies"] + PYPROJECT["dependency-groups"]["go"]
FOR_DEVELOPERS = [
    *FOR_USERS,
    *PYPROJECT["dependency-groups"]["dev"],
    *PYPROJECT["dependency-groups"]["docs"],
    *PYPROJECT["build-system"]["requires"],
]
SEARCH_PATH = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
HOSTS = [".".join(parts) for parts in (("pypi", "org"), ("pythonhosted", "org"), ("npmjs", "org"), ("anaconda", "org"))]


def tracked_texts() -> dict[str, str]:
    """Every text file that git tracks or would track, by path."""
    if shutil.which("git") is None or not (ROOT / ".git").exists():
        pytest.skip("not a git checkout")
    command = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
    listing = subprocess.run(command, cwd=ROOT, check=True, capture_output=True, text=True).stdout
    texts = {}
    for name in filter(None, listing.split("\0")):
        path = ROOT / name
        content = path.read_bytes() if path.is_file() else b""
        if b"\0" not in content[:8192]:
            texts[name] = content.decode("utf-8", errors="replace")
    return texts


def locked(lock: str) -> dict[str, str]:
    """What the lock says of each package, by canonical name: `==VERSION ; MARKER` and its hashes."""
    entries = re.split(r"^(?=[A-Za-z0-9])", LOCKS[lock], flags=re.MULTILINE)[1:]
    return {canonicalize_name(re.split(r"[=\s]", entry)[0]): entry for entry in entries}


def readme_commands() -> list[str]:
    """The lines of README's code blocks that start with `./go`."""
    blocks = re.findall(r"^```[^\n]*\n(.*?)^```", (ROOT / "README.md").read_text(encoding="utf-8"), re.DOTALL | re.M)
    lines = [line.strip().removeprefix("$ ") for block in blocks for line in block.splitlines()]
    return [line for line in lines if line.startswith("./go ")]


def test_no_file_names_a_package_registry() -> None:
    named = [f"{name}: {host}" for name, text in tracked_texts().items() for host in HOSTS if host in text]
    assert not named, "a mirror must be able to stand in: write the package's name, not where it lies"


@pytest.mark.parametrize("lock", LOCKS)
def test_lock_names_no_host(lock: str) -> None:
    assert "://" not in LOCKS[lock]
    assert not re.search(r"^\s*--(?!hash=)", LOCKS[lock], re.MULTILINE), "no option but --hash"


@pytest.mark.parametrize("lock", LOCKS)
def test_lock_pins_and_hashes_every_package(lock: str) -> None:
    for name, entry in locked(lock).items():
        assert re.match(r"[A-Za-z0-9._-]+==[^\s;]+ ", entry), f"{name} is not pinned"
        assert re.search(r"--hash=sha256:[0-9a-f]{64}\b", entry), f"{name} has no hash"


@pytest.mark.parametrize(
    ("lock", "wanted"),
    [("requirements.lock", wanted) for wanted in FOR_USERS]
    + [("requirements-dev.lock", wanted) for wanted in FOR_DEVELOPERS],
)
def test_lock_agrees_with_pyproject(lock: str, wanted: str) -> None:
    requirement = Requirement(wanted)
    entry = locked(lock).get(canonicalize_name(requirement.name))
    assert entry is not None, "not locked; run .ci/lock"
    version = entry.split("==")[1].split()[0]
    assert requirement.specifier.contains(version, prereleases=True), f"{version} is locked; run .ci/lock"


def test_developers_have_the_packages_of_users_in_the_same_versions() -> None:
    """So adding the others changes none of those that a run may be using."""
    users, developers = locked("requirements.lock"), locked("requirements-dev.lock")
    assert {name: entry.split()[0] for name, entry in users.items()}.items() <= {
        name: entry.split()[0] for name, entry in developers.items()
    }.items()


def test_users_get_none_of_the_packages_of_developers() -> None:
    groups = PYPROJECT["dependency-groups"]
    extra = {canonicalize_name(Requirement(wanted).name) for wanted in groups["dev"] + groups["docs"]}
    assert not extra & locked("requirements.lock").keys()


def test_the_page_of_a_registry_has_no_link_to_a_file_that_it_lacks() -> None:
    page = (ROOT / "README.md").read_text(encoding="utf-8")
    hook = PYPROJECT["tool"]["hatch"]["metadata"]["hooks"]["fancy-pypi-readme"]
    for substitution in hook["substitutions"]:
        page = re.sub(substitution["pattern"], substitution["replacement"], page)
    assert not [target for target in re.findall(r"\]\(([^)]*)\)", page) if not target.startswith("http")]
    assert "Quickstart, tutorial with figures" in page, "the words of links stay"


@pytest.mark.parametrize(("arguments", "reason"), [([], "a command is missing"), (["--hlep"], "no option --hlep")])
def test_go_without_a_command_says_how_to_use_it(arguments: list[str], reason: str) -> None:
    outcome = subprocess.run([ROOT / "go", *arguments], capture_output=True, text=True, check=False)
    assert (outcome.returncode, outcome.stdout) == (2, "")
    assert reason in outcome.stderr
    assert "usage: ./go COMMAND" in outcome.stderr


@pytest.mark.parametrize("option", ["--help", "-h"])
def test_go_has_help(option: str) -> None:
    outcome = subprocess.run([ROOT / "go", option], capture_output=True, text=True, check=False)
    assert (outcome.returncode, outcome.stderr) == (0, "")
    assert outcome.stdout.startswith("usage: ./go COMMAND")


def test_coverage_leaves_out_all_that_is_compiled_and_no_more() -> None:
    """It cannot see machine code, so lines that run only there would count as lines that no test runs."""
    patterns = PYPROJECT["tool"]["coverage"]["report"]["exclude_also"]
    makers = [name for name, made in vars(compiled).items() if getattr(made, "__module__", "") == compiled.__name__]
    functions = [name for name in makers if not isinstance(getattr(compiled, name), type)]
    decorators = {name for name in functions if "function" in signature(getattr(compiled, name)).parameters}
    left_out = {name for name in makers if any(re.search(pattern, f"@{name}") for pattern in patterns)}
    assert left_out == {name for name in decorators if not name.startswith("_")}


def test_readme_commands_exist() -> None:
    commands = [shlex.split(line, comments=True)[1:] for line in readme_commands()]
    assert commands, "README shows how to run something"
    made = tuple(f"{command[2]}/" for command in commands if command[:2] == ["stepgap", "new"])
    for program, *arguments in commands:
        assert shutil.which(program, path=SEARCH_PATH), f"README runs {program}"
        for argument in arguments:
            if argument.endswith((".py", ".sh", ".toml")) and not argument.startswith(made):
                assert (ROOT / argument).exists(), f"README names {argument}"


def test_readme_verbs_exist() -> None:
    commands = [shlex.split(line, comments=True)[1:] for line in readme_commands()]
    verbs = {command[1] for command in commands if command[0] == "stepgap" and command[1:] and command[1][0] != "-"}
    for verb in sorted(verbs):
        stepgap = shutil.which("stepgap", path=SEARCH_PATH) or "stepgap"
        outcome = subprocess.run([stepgap, verb, "--help"], capture_output=True, text=True, check=False)
        assert outcome.returncode == 0, f"README uses `stepgap {verb}`: {outcome.stderr}"
        assert f"stepgap {verb}" in outcome.stdout, f"README uses `stepgap {verb}`, which its help does not know"


def test_readme_names_every_verb_of_the_help() -> None:
    table = [line for line in (ROOT / "README.md").read_text(encoding="utf-8").splitlines() if line.startswith("|")]
    named = {word for line in table for word in re.findall(r"`(\w+)`", line)}
    assert named == {verb for verbs in GROUPS.values() for verb in verbs}


def test_a_release_is_published_from_a_checked_tag_without_a_token() -> None:
    """Only the job that uploads may name itself to the registry, and it waits for a person and runs no code of ours."""
    text = (ROOT / ".github/workflows/release.yml").read_text(encoding="utf-8")
    release = yaml.safe_load(text)
    assert release[True] == {"push": {"tags": ["v*"]}}, "YAML reads the key `on` as true"
    build, objects, publish = (release["jobs"][name] for name in ("build", "objects", "publish"))
    assert release["permissions"] == {"contents": "read"}
    assert "permissions" not in build
    assert "permissions" not in objects
    assert publish["permissions"] == {"id-token": "write"}
    assert (objects["needs"], publish["needs"], publish["environment"]) == ("build", "objects", "release")
    for version in objects["strategy"]["matrix"]["python"]:
        assert f"Programming Language :: Python :: {version}" in PYPROJECT["project"]["classifiers"]
    assert all("uses" in step for step in publish["steps"])
    assert "sh .ci/package" in [step.get("run") for step in build["steps"]]
    assert "secrets." not in text


def test_the_workflow_runs_the_check_and_the_tests_with_pythons_that_we_name() -> None:
    (job,) = yaml.safe_load((ROOT / ".github/workflows/ci.yml").read_text(encoding="utf-8"))["jobs"].values()
    classifiers = PYPROJECT["project"]["classifiers"]
    for version in job["strategy"]["matrix"]["python"]:
        assert f"Programming Language :: Python :: {version}" in classifiers
    assert {step["uses"].partition("@")[0] for step in job["steps"] if "uses" in step} == {
        "actions/checkout",
        "actions/setup-python",
    }
    commands = [step["run"] for step in job["steps"] if "run" in step]
    assert {"sh .ci/check", "sh .ci/package"} < set(commands)
    assert any(command.startswith("./go pytest") for command in commands)
