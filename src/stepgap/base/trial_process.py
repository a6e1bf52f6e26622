"""Files of others in another process, with limits: one that ends its reader, or never lets it end, ends that only."""

import json
import signal
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any


def answer_of(
    module: str, arguments: Sequence[str], reader: str, seconds: int, memory: int, folder: Path | None = None
) -> dict[str, Any]:
    """Runs `python -m MODULE ARGUMENTS SECONDS BYTES`, a program that calls `print_answer`, and returns its answer.

    Args:
        arguments: The arguments before the limits.
        reader: What reads the file, for messages.
        seconds: Longest time of a processor that it may need [s].
        memory: Largest memory that it may need [bytes].
        folder: Current folder of the process; the same as here if there is none.

    Raises:
        ValueError: It ends without an answer, or needs too much time or memory; the message is the reason.
    """
    command = [sys.executable, "-P", "-m", module, *arguments, str(seconds), str(memory)]
    try:
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=5 * seconds, check=False)
    except subprocess.TimeoutExpired:
        raise ValueError(f"{reader} does not load it within {5 * seconds} s") from None
    if done.returncode in (-signal.SIGXCPU, -signal.SIGKILL):
        raise ValueError(f"{reader} needs more than {seconds} s to load it")
    try:
        answer = json.loads(done.stdout)
    except ValueError:
        reason = " ".join(done.stderr.split())[-200:] or f"code {done.returncode}"
        raise ValueError(f"{reader} ends while it loads it: {reason}") from None
    if "error" in answer:
        raise ValueError(f"{answer['error']:.300}")
    return answer


def print_answer(read: Callable[[], Mapping[str, Any]], seconds: int, memory: int) -> None:
    """Sets the limits of this process, and prints what `read` returns, or under `error` why it returns nothing."""
    import resource  # not available on Windows

    for kind, limit in ((resource.RLIMIT_CPU, seconds), (resource.RLIMIT_AS, memory)):
        _, hard = resource.getrlimit(kind)
        with suppress(OSError, ValueError):  # macOS has no limit of the memory
            resource.setrlimit(kind, (limit if hard == resource.RLIM_INFINITY else min(limit, hard), hard))
    try:
        answer = read()
    except MemoryError:
        answer = {"error": f"it needs more than {memory / 2**30:.0f} GiB of memory"}
    except Exception as error:  # of any kind
        answer = {"error": " ".join(str(error).split()) or type(error).__name__}
    json.dump(answer, sys.stdout)
