"""A text that is no DBC costs no parser its memory."""

import pytest

from bms_gateway.errors import ConfigError
from bms_gateway.frames.dbc import parse


def test_a_text_of_marks_alone_is_not_parsed():
    """8 MiB of semicolons took 172 MiB before the bound on memory ended it."""
    with pytest.raises(ConfigError, match=r"marks\.dbc: over 2,000,000 words and marks, more than"):
        parse("marks.dbc", ";" * 2_000_001)
