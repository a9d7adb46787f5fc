"""The content of DBC files: looked up by "Message.Signal", compiled to one table of the wanted signals."""

from collections.abc import Callable, Mapping, Sequence
from copy import copy
from dataclasses import replace

from bms_gateway.errors import ConfigError, did_you_mean
from bms_gateway.frames.batch import EXTENDED
from bms_gateway.frames.dbc import parse
from bms_gateway.frames.signal_info import MessageInfo, SignalInfo
from bms_gateway.frames.signal_table import SignalTable

__all__ = ["Database"]

Read = Callable[[str, str], Sequence[MessageInfo]]


class Database:
    """All messages of all DBC files of one gateway.

    Attributes
    ----------
    messages : mapping of name to MessageInfo
        In the order of the files; a name that two files share appears under its last file only, see `resolve`.
    """

    def __init__(self, messages: Sequence[MessageInfo]) -> None:
        self.messages: dict[str, MessageInfo] = {m.name: m for m in messages}
        self._shared = _names_of_several(messages)

    @classmethod
    def load(cls, texts: Mapping[str, str], read: Read = parse) -> "Database":
        """Parse DBC texts strictly.

        Parameters
        ----------
        texts : mapping of file name to text
        read : callable, optional
            Returns the messages of a file by its name and text, as `dbc.parse` does, or from a cache.

        Raises
        ------
        ConfigError
            A text is not a valid DBC (names the file, the line and what to do), or two messages share an identifier.
        """
        messages: list[MessageInfo] = []
        for name, text in texts.items():
            messages.extend(read(name, text))
        by_id: dict[int, MessageInfo] = {}
        for message in messages:
            other = by_id.setdefault(message.can_id, message)
            if other is not message:
                raise ConfigError(
                    f"{message.database}: message {message.name} has the identifier {_hex(message.can_id)} of "
                    f"{other.name} in {other.database}; leave one of them out"
                )
        return cls(messages)

    def message(self, name: str) -> MessageInfo:
        """Find one message.

        Raises
        ------
        ConfigError
            Unknown, with the nearest name, or in two files.
        """
        if name not in self.messages:
            raise ConfigError(f"no message '{name}' in the DBC{did_you_mean(name, self.messages)}")
        if name in self._shared:
            raise ConfigError(f"message '{name}' is in {' and in '.join(self._shared[name])}; rename one of them")
        return self.messages[name]

    def resolve(self, path: str) -> SignalInfo:
        """Find one signal by "Message.Signal".

        Raises
        ------
        ConfigError
            The message is unknown, or it has no such signal; names the nearest.
        """
        message_name, dot, signal_name = path.partition(".")
        if not dot or not signal_name:
            raise ConfigError(f"'{path}' is not of the form Message.Signal{self._holders(path)}")
        message = self.message(message_name)
        if signal_name not in message.signals:
            near = did_you_mean(signal_name, message.signals)
            raise ConfigError(f"message '{message_name}' has no signal '{signal_name}'{near}")
        return message.signals[signal_name]

    def compile(self, signals: Sequence[str]) -> SignalTable:
        """Tabulate the bits of just these signals, for `decode`.

        Raises
        ------
        ConfigError
            As for `resolve`, or a signal that cannot be decoded (scale 0, multiplexer wider than 32 bits).
        """
        wanted = [self.resolve(path) for path in signals]
        for info in wanted:
            if info.scale == 0.0:
                raise ConfigError(f"{info.database}: signal {info.path} has the scale 0; correct it in the DBC")
        return SignalTable.build(wanted, self.messages)

    def changed(self, signals: Sequence[SignalInfo]) -> "Database":
        """Return a database with these signals replaced; all else stays the same."""
        new = copy(self)
        new.messages = dict(self.messages)
        for info in signals:
            message = new.messages[info.message]
            new.messages[info.message] = replace(message, signals={**message.signals, info.name: info})
        return new

    def _holders(self, name: str) -> str:
        """List the messages that have a signal of this name, for a user who did not name the message."""
        holders = [m.name for m in self.messages.values() if name in m.signals]
        if holders:
            return f"; did you mean '{holders[0]}.{name}'?"
        return did_you_mean(name, self.messages)


def _names_of_several(messages: Sequence[MessageInfo]) -> dict[str, list[str]]:
    files: dict[str, list[str]] = {}
    for m in messages:
        files.setdefault(m.name, []).append(m.database)
    return {name: where for name, where in files.items() if len(where) > 1}


def _hex(can_id: int) -> str:
    return f"0x{can_id & ~EXTENDED:X}" + (" (29 bits)" if can_id & EXTENDED else "")
