"""Where a command's words go: text for people on standard output, unless JSON has it."""

import json
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from bms_gateway.errors import UsageError


def say(text: str, json_target: str | None = None) -> None:
    """Print text for people; on standard error where standard output is the JSON's."""
    print(text, file=sys.stderr if json_target == "-" else sys.stdout)


def note(text: str) -> None:
    """Print a remark that belongs to no result."""
    print(f"bms-gateway: note: {text}", file=sys.stderr)


def write_json(target: str, document: Mapping[str, Any]) -> None:
    """Write a result for machines to a file, or to standard output for `-`.

    Raises
    ------
    UsageError
        The file cannot be written.
    """
    text = json.dumps(document, indent=2, ensure_ascii=False, allow_nan=False) + "\n"
    if target == "-":
        sys.stdout.write(text)
        return
    try:
        Path(target).write_text(text, encoding="utf-8")
    except OSError as e:
        raise UsageError(f"--json {target}: cannot be written: {e.strerror}") from None
