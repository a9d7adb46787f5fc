"""What a report holds packed."""

import sys

import pytest

from bms_gateway.errors import UsageError
from bms_gateway.report.page import packed


def test_a_python_without_lzma_is_told_what_to_do(monkeypatch):
    monkeypatch.setitem(sys.modules, "lzma", None)
    with pytest.raises(UsageError, match=r"needs the module lzma.*liblzma-dev"):
        packed("figure", b"content")
