"""Find and read DBC files; a DBC that was parsed before is read from a cached table.

Parsing a DBC takes longer than the rest of a start, and cantools needs more memory for it than a string of cells. The
content of a DBC is therefore cached as a table (`frames.packed`). The table of our own DBC lies beside it in the
package; other tables lie in systemd's CacheDirectory, or in the user's cache directory. A table is used only if its
first line shows that it was made from exactly this text by these versions, if it is complete and unchanged, and if no
other user could have written it. Otherwise the DBC is parsed. If no table can be written, only the next start is
slower.
"""

import hashlib
import os
import stat
from contextlib import suppress
from pathlib import Path

from bms_gateway import __version__
from bms_gateway.config.read_bounds import bounded
from bms_gateway.config.text_file import WINDOWS, decoded, read_bytes
from bms_gateway.errors import ConfigError
from bms_gateway.folders import open_folder
from bms_gateway.frames.dbc import parse
from bms_gateway.frames.own_dbc import OWN_DBC
from bms_gateway.frames.packed import pack, unpack
from bms_gateway.frames.signal_info import MessageInfo
from bms_gateway.whole import replaced

FORMAT = 4
"""To be increased when `frames.packed` writes another format, or `frames.dbc` reads the same text differently."""
OWN_TABLE = "dbc/bms_gateway.table"
"""Table of our DBC in the checkout, made by `python dbc/tabulate.py`."""
KEPT = 32
"""Most tables in the directory. Each has some 100 kB, and every change of a DBC makes a new one."""
MOST_BYTES = 8 << 20
"""Longest text of a DBC, bytes; a vehicle's has one or two MB, and cantools takes ten times as much memory."""
LARGEST_TABLE = 16 << 20
_NOT_OURS = stat.S_IWGRP | stat.S_IWOTH


def read_dbc(name: str, text: str) -> list[MessageInfo]:
    """Read a DBC by its table, else by parsing it.

    Parameters
    ----------
    name : str
        Name of the file, for the messages and for error lines.
    text : str

    Raises
    ------
    ConfigError
        As `frames.dbc.parse`.
    """
    with bounded(name):
        return _read(name, text)


def _read(name: str, text: str) -> list[MessageInfo]:
    digest = _sha256(text)
    if name == OWN_DBC and (found := _believed(name, _shipped_table(), shipped_head(digest))) is not None:
        return found
    directory = _directory()
    if directory is None:
        return _parsed(name, text)
    head = f"bms-gateway-dbc {FORMAT} {__version__} cantools-{_version_of_cantools()} {digest}"
    file = directory / f"{_sha256(head)[:32]}.table"
    found = _believed(name, _content(file), head)
    if found is None:
        found = _parsed(name, text)
        _keep(file, table(head, found))
    return found


def _parsed(name: str, text: str) -> list[MessageInfo]:
    """Parse without the warnings of cantools: a message that occurs twice is reported where it is used."""
    import logging  # with cantools

    logging.getLogger("cantools").setLevel(logging.ERROR)
    return parse(name, text)


def table(head: str, messages: list[MessageInfo]) -> str:
    """Write a table that begins with this line, by which a reader recognises it as valid."""
    body = pack(messages)
    return f"{head} {_sha256(body)}\n{body}"


def shipped_head(digest: str) -> str:
    """First line, less the check sum, of the table that comes with the package, for a DBC with this SHA-256."""
    return f"bms-gateway-dbc {FORMAT} shipped {digest}"


def own_dbc_text() -> str:
    """Read the text of our DBC from the checkout or from the installed wheel.

    Raises
    ------
    ConfigError
        Neither is there: the installation is incomplete.
    """
    return shipped(f"dbc/{OWN_DBC}").read_text(encoding="utf-8")


def dbc_text(file: Path) -> str:
    """Decode a DBC, which names no encoding: UTF-8 if it is valid, otherwise the encoding of Windows tools.

    Raises
    ------
    ConfigError
        Cannot be read, or is too long.
    """
    raw = read_bytes(file, MOST_BYTES)
    try:
        return decoded(raw, "utf-8-sig", file, MOST_BYTES)
    except UnicodeDecodeError:
        return decoded(raw, WINDOWS, file, MOST_BYTES)


def shipped(name: str) -> Path:
    """Find a file that comes with the package, by its path in the checkout.

    Raises
    ------
    ConfigError
        It is neither in the checkout nor in the installed wheel: the installation is incomplete.
    """
    package = Path(__file__).resolve().parents[1]
    for place in (package / "shipped" / name, package.parent / name):
        if place.is_file():
            return place
    raise ConfigError(f"{name}: not found beside the package; install bms-gateway again")


def _shipped_table() -> bytes | None:
    try:
        return shipped(OWN_TABLE).read_bytes()
    except (ConfigError, OSError):  # the DBC itself is what counts
        return None


def _believed(name: str, content: bytes | None, head: str) -> list[MessageInfo] | None:
    """Read the messages of a table; None if the table is not valid."""
    if content is None:
        return None
    first, _, body = content.partition(b"\n")
    if first != f"{head} {hashlib.sha256(body).hexdigest()}".encode():
        return None
    try:
        return unpack(name, body.decode())
    except (ValueError, TypeError, IndexError):
        return None


def _content(file: Path) -> bytes | None:
    """Content of a table that nobody but this user can have written; None otherwise."""
    try:
        # there may be anything of this name, even a pipe: opening it must not block
        handle = os.open(file, os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK | os.O_NOFOLLOW)
    except OSError:
        return None
    try:
        s = os.fstat(handle)
        if (
            not stat.S_ISREG(s.st_mode)
            or s.st_mode & _NOT_OURS
            or s.st_uid != os.geteuid()
            or s.st_size > LARGEST_TABLE
        ):
            return None
        with open(handle, "rb", closefd=False) as f:
            return f.read()
    except OSError:
        return None
    finally:
        os.close(handle)


def _keep(file: Path, content: str) -> None:
    """Write a table in one step, and remove the oldest of more than `KEPT`; a failure to write is no error."""
    with suppress(OSError):
        file.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        at = open_folder(file.parent)  # root may have another user's home
        try:
            with replaced(at, file.name, 0o600) as f:
                f.write(content.encode())
            with os.scandir(at) as found:
                tables = [
                    (f.stat(follow_symlinks=False).st_mtime_ns, f.name) for f in found if f.name.endswith(".table")
                ]
            for _, old in sorted(tables, reverse=True)[KEPT:]:
                os.unlink(old, dir_fd=at)
        finally:
            os.close(at)


def _directory() -> Path | None:
    """Find the directory of the tables; None if there is none."""
    # systemd lists several directories with colons; ours is the first
    if given := os.environ.get("CACHE_DIRECTORY", "").split(":")[0]:
        return Path(given)
    home = os.environ.get("HOME", "")
    place = os.environ.get("XDG_CACHE_HOME") or (f"{home}/.cache" if home else "")
    return Path(place) / "bms-gateway" if Path(place).is_absolute() else None


def _version_of_cantools() -> str:
    """Give the installed version of cantools without loading it: another version may read a text differently."""
    from importlib.metadata import version

    return version("cantools")


def _sha256(text: str) -> str:
    return hashlib.sha256(text.encode("utf-8", "surrogatepass")).hexdigest()
