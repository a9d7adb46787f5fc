"""Estimates, before a JSON text is parsed, whether this would need hundreds of megabytes."""

from typing import Final

# A value of a few bytes takes about sixty bytes of memory: a number less, a text or a list more. The state of a string
# of four cells has 1,100 commas and other marks.
MAX_COMMAS: Final = 4_000_000
MAX_MARKS: Final = 1_000_000


def is_dear(body: bytes) -> bool:
    """Whether a JSON text would need hundreds of megabytes.

    Examples
    --------
    >>> is_dear(b'{"a": [1, 2]}'), is_dear(b"[" + b"[]," * 1_000_000 + b"[]]")
    (False, True)
    """
    return body.count(b",") > MAX_COMMAS or sum(map(body.count, (b'"', b"[", b"{"))) > MAX_MARKS
