"""JSON that would need hundreds of megabytes, told before it is parsed."""

from typing import Final

# What is made of a few bytes takes some sixty each: numbers fewer, texts and lists more. A state of ours has 1,100 such
# marks, commas and all, for a string of four cells.
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
