"""Whether two readings of a DBC are the same."""


def same(found, truth) -> bool:
    """Alike to the order of signals, of labels, and to the bit."""
    return repr(found) == repr(truth) and found == truth
