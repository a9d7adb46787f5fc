"""Keys of logs whose names are unusual."""

import os
from pathlib import Path

import pytest

from bms_gateway.cli.fleet import once
from bms_gateway.fleet.keys import place_key


@pytest.fixture
def odd(tmp_path) -> list[Path]:
    loop, no_text = tmp_path / "loop.log", tmp_path / os.fsdecode(b"drive\xff.log")
    loop.symlink_to(loop)
    no_text.write_text("")
    return [loop, no_text]


def test_a_link_to_itself_and_a_name_that_is_no_text_have_keys_of_their_own(odd):
    assert len({place_key(log) for log in odd}) == 2


def test_each_of_them_is_listed_once(odd):
    assert once([*odd, *odd]) == odd
