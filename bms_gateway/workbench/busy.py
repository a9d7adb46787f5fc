"""The answer of a desk that is already at work."""

from bms_gateway.errors import UsageError


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
