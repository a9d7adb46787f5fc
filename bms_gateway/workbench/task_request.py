"""Request of the running task of a tab, whose answer may come from another tab with the same request."""

from pathlib import Path
from typing import Any

from bms_gateway.workbench.shared import Shared, Tab, key_of

Document = dict[str, Any]


class TaskRequest:
    """See the module's text.

    Parameters
    ----------
    tab : Tab
    shared : Shared or None
        Answers of all tabs; without it the tab computes everything itself.

    Attributes
    ----------
    content : dict
        Input of the computing process.
    waits : bool
        Whether another tab computes the answer.
    """

    def __init__(self, tab: Tab, shared: Shared | None) -> None:
        self.content: Document = {}
        self.waits = False
        self._tab, self._shared, self._key = tab, shared, ""

    def start(self, content: Document, same: str) -> None:
        """Make a new request; `same` is the digest of the open records."""
        self.content = content
        self._key = key_of(content, same) if self._shared else ""
        self.waits = bool(self._shared and self._key and not self._shared.ask(self._key, self._tab))

    def has(self, key: str) -> bool:
        """Whether the key is that of the present request."""
        return key == self._key

    def answered(self, answer: Document, folder: Path) -> None:
        """Give the answer of this tab's process to the other tabs."""
        if self._shared is not None and self._key:
            self._shared.answered(self._key, answer, folder)

    def leave(self) -> None:
        """End the tab's interest in the answer."""
        key, self._key, self.waits = self._key, "", False
        if self._shared is not None and key:
            self._shared.leave(key, self._tab)
