"""The tasks of a desk, and its answer while it is at work."""

from bms_gateway.errors import UsageError

TITLES = {
    "look": "looking at the table",
    "open": "reading the files",
    "compare": "comparing the model with the readings",
    "diagnose": "looking for the missing effect",
    "add": "adding and refitting",
    "report": "writing the report",
    "track": "reading the column",
}
"""What the page says of a running task."""


class BusyError(UsageError):
    """The desk is at work: the request can be repeated when `title` has ended.

    Parameters
    ----------
    title : str
        Name of the running task.
    """

    def __init__(self, title: str) -> None:
        super().__init__(f"still {title}: wait for it or cancel it")
        self.title = title
