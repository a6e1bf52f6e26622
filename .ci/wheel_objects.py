"""Makes, from the pure wheel, one that brings compiled code, for the Python and the kind of computer that run this.

    python .ci/wheel_objects.py dist/stepgap-X.Y.Z-py3-none-any.whl FOLDER [--compare]

It installs the wheel with pip in a new environment, runs there what users run first, with Numba told to compile for
x86-64-v3 or for any ARMv8 instead of this very processor, and adds the files of Numba's cache to the wheel. The new
wheel is installed in its place, and must run without compilation. `--compare` prints the processor time of a first
result of both. What users' computers do with the code: `src/stepgap/base/compiled.py`.
"""

import argparse
import json
import os
import platform
import shutil
import subprocess
import sys
import venv
from pathlib import Path
from resource import RUSAGE_CHILDREN, getrusage
from tempfile import TemporaryDirectory

TARGETS = {
    ("Linux", "x86_64"): ("manylinux_2_28_x86_64", "x86-64-v3"),
    ("Linux", "aarch64"): ("manylinux_2_28_aarch64", "generic"),
    ("Darwin", "arm64"): ("macosx_14_0_arm64", "generic"),
}
"""Tag of the wheel's platform, and the processor for which LLVM compiles."""

FEATURES = {
    "x86-64-v3": ["avx2", "bmi", "bmi2", "cx16", "f16c", "fma", "lzcnt", "movbe", "popcnt", "sahf", "sse4.2", "xsave"],
    "generic": [],
}
"""What a processor must have to run that code, in the names of LLVM; every ARMv8 of 64 bits runs the other."""

FIRST = "run --reference short.csv --iterations 0"
USED = (
    "run",
    "run --reference short.csv --iterations 1 --online",
    "run --reference short.csv --iterations 1 --method paper",
    "run --reference short.csv --iterations 0 --ground.stair_height 0.03",
    "run --robot quadruped --iterations 1",
    "check hopper",
    "check quadruped",
    "check monopod",
)
"""What users do first: its compiled code is packed."""

TARGET = """
from numba.core.registry import cpu_target
print(*cpu_target.target_context.codegen().magic_tuple(), sep="\\n")
"""


def main() -> None:
    """Writes the wheel, and checks it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("wheel", type=Path)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--compare", action="store_true")
    given = parser.parse_args()
    tag, processor = TARGETS[platform.system(), platform.machine()]
    with TemporaryDirectory() as temporary:
        work = Path(temporary)
        venv.create(work / "environment", with_pip=True)
        python(work, "-m", "pip", "install", "--quiet", "wheel", str(given.wheel.resolve()))
        without = first_result(work, "without") if given.compare else 0.0
        environment = {"NUMBA_CPU_NAME": processor, "NUMBA_CPU_FEATURES": "", "NUMBA_CACHE_DIR": str(work / "cache")}
        for line in USED:
            python(work, "-m", "stepgap", *line.split(), **environment)
        target = {
            "machine": platform.machine(),
            "system": platform.system(),
            "features": FEATURES[processor],
            "target": python(work, "-c", TARGET, **environment).split("\n")[:3],
        }
        wheel = packed(work, given.wheel.resolve(), target, tag)
        python(work, "-m", "pip", "install", "--quiet", "--force-reinstall", "--no-deps", str(wheel))
        with_objects = first_result(work, "with")
        if compiled := sorted(path.name for path in (work / "with").rglob("*.nbc")):
            sys.exit(f"wheel_objects: compiled in spite of the wheel: {', '.join(compiled)}")
        if given.compare:
            ratio = with_objects / without
            print(f"first result: {without:.1f} s without, {with_objects:.1f} s with compiled code: {ratio:.2f}")
        given.folder.mkdir(parents=True, exist_ok=True)
        print(shutil.copy(wheel, given.folder), f"{wheel.stat().st_size / 1e6:.1f} MB")


def python(work: Path, *arguments: str, **environment: str) -> str:
    """Output of Python in the new environment, outside of the checkout."""
    (work / "short.csv").write_text("speed,height\n0.3,0.6\n0.3,0.6\n0.3,0.6\n")
    command = [str(work / "environment" / "bin" / "python"), *arguments]
    outcome = subprocess.run(
        command, cwd=work, env={**os.environ, **environment}, stdout=subprocess.PIPE, text=True, check=True
    )
    return outcome.stdout


def first_result(work: Path, cache: str) -> float:
    """Processor time until three hops are done, with a new cache [s]."""
    before = getrusage(RUSAGE_CHILDREN)
    python(work, "-m", "stepgap", *FIRST.split(), NUMBA_CACHE_DIR=str(work / cache))
    after = getrusage(RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def packed(work: Path, wheel: Path, target: dict[str, object], tag: str) -> Path:
    """The wheel with the files of the cache, whose names are those of this Python's version, too."""
    python(work, "-m", "wheel", "unpack", str(wheel), "--dest", "unpacked")
    (root,) = (work / "unpacked").iterdir()
    digest = "[0-9a-f]" * 16
    (code,) = (work / "cache").glob(f"{digest}-{digest}")  # of the package alone
    objects = root / "stepgap" / "objects" / code.name
    shutil.copytree(code, objects)
    (objects / "target.json").write_text(json.dumps(target, indent=2) + "\n")
    (work / "packed").mkdir()
    python(work, "-m", "wheel", "pack", str(root), "--dest-dir", "packed")
    version = f"cp{sys.version_info.major}{sys.version_info.minor}"
    (pure,) = (work / "packed").iterdir()
    python(work, "-m", "wheel", "tags", "--python-tag", version, "--platform-tag", tag, "--remove", str(pure))
    (tagged,) = (work / "packed").iterdir()
    return tagged


if __name__ == "__main__":
    main()
