"""What a hostile file may cost."""

GIB = 1 << 30


BOUND_MIB = 400
"""Of a whole process that reads it, numpy and python-can loaded."""
