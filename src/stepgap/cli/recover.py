"""The verb `stepgap recover`."""

from pathlib import Path

from stepgap.base.output_files import check_new, free_name


def recover(file: Path, /, *, out: Path | None = None) -> None:
    """Recover the intact part of a truncated or damaged run, steps.csv or tick log.

    Args:
        file: The folder of the run, its steps.csv, or a tick log (.mcap); it is not changed.
        out: New folder or file for the intact part. [default: NAME_recovered next to it]
    """
    from stepgap.records.recovery import recover_file

    if out:
        check_new(out, "--out")
    named = file if file.name else file.resolve()  # such as "."
    target = out or free_name(named.with_stem(f"{named.stem}_recovered"))
    for line in recover_file(file, target):
        print(line)
    print(target)
