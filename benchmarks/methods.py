"""The tracking errors of each method in sweeps over the axis `method`, as a table in Markdown.

For each method: the RMSE of each coordinate in the last deployment of a case, median and range of all cases; the number
of deployments; and the failed steps of all deployments together.

    ./go python benchmarks/methods.py FOLDER [FOLDER …]
"""

import argparse
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from stepgap.step import Array
from stepgap.sweep.results_table import ResultsTable, read_results


def rows(results: ResultsTable) -> Iterator[list[str]]:
    """Cells of the table: a header, then a row for each method."""
    columns = results.columns
    last = np.append(np.diff(columns["case"]) != 0, True)
    tracked = [name for name in results.state_names if np.isfinite(columns[f"rmse_{name}"]).any()]
    yield ["method", *(f"RMSE of {name} [10⁻³]" for name in tracked), "deployments", "failed steps"]
    for method in dict.fromkeys(columns["method"]):
        here = columns["method"] == method
        errors = [columns[f"rmse_{name}"][here & last] for name in tracked]
        count = int(np.count_nonzero(here)), int(columns["falls"][here].sum())
        yield [f"`{method}`", *map(_spread, errors), *map(str, count)]


def _spread(errors: Array) -> str:
    """Median of errors, and their range, in thousandths."""
    return "{:.2f} ({:.2f}–{:.2f})".format(*(1e3 * np.quantile(errors, [0.5, 0, 1])))


def main() -> None:
    """Prints a table for each folder."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folders", nargs="+", type=Path, help="folders of sweeps")
    for folder in parser.parse_args().folders:
        header, *body = rows(read_results(folder / "results.csv"))
        print(f"\n{folder.name}\n")
        for row in (header, ["---"] * len(header), *body):
            print(f"| {' | '.join(row)} |")


if __name__ == "__main__":
    main()
