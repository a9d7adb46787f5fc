"""A range of [0|0] states none, however its zeros are written."""

import pytest

from bms_gateway.frames.dbc import parse


@pytest.mark.parametrize("zero", ["0|0", "0.0|0.0", "0|0.0", "0.000|0e0"])
def test_a_range_of_zeros_is_none(zero):
    text = f'VERSION ""\nBU_: B\nBO_ 256 A: 8 B\n SG_ S : 0|16@1+ (0.1,0) [{zero}] "A" B\n'
    s = parse("a.dbc", text)[0].signals["S"]
    assert (s.minimum, s.maximum) == (None, None)
