"""Shards from I/N and from the variables of job arrays."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from stepgap.base.errors import InputError
from stepgap.sweep.cases.shard import Shard, parse_shard, shard_of_job_array


@given(st.integers(1, 50), st.integers(0, 300))
def test_every_case_is_in_exactly_one_shard(count: int, cases: int) -> None:
    parts = [list(Shard(index, count).numbers(cases)) for index in range(1, count + 1)]
    assert sorted(number for part in parts for number in part) == list(range(cases))
    assert max(map(len, parts)) - min(map(len, parts)) <= 1


def test_a_shard_is_written_as_a_fraction() -> None:
    assert parse_shard("2/3") == Shard(2, 3)


@pytest.mark.parametrize("text", ["", "0/3", "4/3", "1", "a/b", "1/3/5", "-1/3", "1.0/3", "1/ 3", "9" * 12 + "/1"])
def test_other_texts_are_refused(text: str) -> None:
    with pytest.raises(InputError, match="--shard"):
        parse_shard(text)


@pytest.mark.parametrize(
    ("variables", "shard"),
    [
        ({}, None),
        ({"SLURM_JOB_ID": "7"}, None),
        ({"SLURM_ARRAY_TASK_ID": "0", "SLURM_ARRAY_TASK_MIN": "0", "SLURM_ARRAY_TASK_MAX": "9"}, Shard(1, 10)),
        ({"SLURM_ARRAY_TASK_ID": "10", "SLURM_ARRAY_TASK_MIN": "1", "SLURM_ARRAY_TASK_MAX": "10"}, Shard(10, 10)),
        (
            {
                "SLURM_ARRAY_TASK_ID": "7",
                "SLURM_ARRAY_TASK_MIN": "3",
                "SLURM_ARRAY_TASK_MAX": "11",
                "SLURM_ARRAY_TASK_STEP": "4",
            },
            Shard(2, 3),
        ),
        ({"LSB_JOBINDEX": "0", "LSB_JOBINDEX_END": "0"}, None),
        ({"LSB_JOBINDEX": "3", "LSB_JOBINDEX_END": "8"}, Shard(3, 8)),
        ({"SGE_TASK_ID": "undefined", "SGE_TASK_LAST": "undefined"}, None),
        (
            {"SGE_TASK_ID": "5", "SGE_TASK_FIRST": "1", "SGE_TASK_LAST": "9", "SGE_TASK_STEPSIZE": "2"},
            Shard(3, 5),
        ),
    ],
)
def test_job_arrays(variables: dict[str, str], shard: Shard | None) -> None:
    assert shard_of_job_array(variables) == shard


@pytest.mark.parametrize("name", ["PBS_ARRAY_INDEX", "PBS_ARRAYID"])
def test_pbs_needs_the_number_of_tasks(name: str) -> None:
    with pytest.raises(InputError, match=rf"--shard \${name}/N"):
        shard_of_job_array({name: "3"})
