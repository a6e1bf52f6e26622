"""Counts of sensors on a bus."""

from hypothesis import given
from hypothesis import strategies as st

from stepgap.hardware.ethercat.sensor_channels import unwrapped


@given(st.integers(-(2**40), 2**40), st.sampled_from([8, 16, 32]), st.data())
def test_a_counter_that_wraps_is_unwrapped(count: int, bits: int, data: st.DataObject) -> None:
    step = data.draw(st.integers(-(2 ** (bits - 1)), 2 ** (bits - 1) - 1))
    raw = (count + step) % 2**bits
    assert unwrapped(raw, count, bits) == count + step
    assert unwrapped(raw - 2**bits, count, bits) == count + step, "read with a sign or without"
