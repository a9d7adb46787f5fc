"""Files that hold a secret: found beside the config or among systemd's credentials, refused when open to others."""

import os
import stat
from collections.abc import Callable
from pathlib import Path

from bms_gateway.errors import ConfigError

SECRET_KEYS = frozenset({"password_file", "key_file"})
MOST_BYTES = 4096


def credential(find: Callable[[Path, str, str], Path], config: Path, name: str, key: str) -> Path:
    """Find a file that the config names; a systemd credential of the same name takes precedence.

    The service runs as a user of its own and cannot read a file that is for root alone.
    ``LoadCredential=mqtt-password:/etc/…`` in the unit passes the file to the service. So one config serves both the
    service and a person who checks it by hand.

    Parameters
    ----------
    find : callable
        Finds a file relative to the config, or raises.
    config : Path
    name, key : str
        As written, and its place in the config.
    """
    passed_on = os.environ.get("CREDENTIALS_DIRECTORY", "")
    if passed_on and (file := Path(passed_on) / Path(name).name).is_file():
        return file
    return find(config, name, key)


def check_secret(file: Path, where: str) -> None:
    """Refuse a file that more than its owner and group may read, or that others than its owner may change.

    Raises
    ------
    ConfigError
        The message contains the command that repairs it.
    """
    mode = file.stat().st_mode
    if mode & (stat.S_IRWXO | stat.S_IWGRP):
        raise ConfigError(f"{where}: {str(file)!r} is open to others (mode {stat.S_IMODE(mode):04o}): chmod 600 {file}")


def read_secret(file: Path, where: str) -> str:
    """Read the first line of a secret's file, checked anew: it may have been changed since.

    Raises
    ------
    ConfigError
        Not readable, open to others, empty, or no text.
    """
    try:
        check_secret(file, where)
        with file.open("rb") as f:
            text = f.read(MOST_BYTES).decode().split("\n", 1)[0].rstrip("\r")
    except OSError as e:
        raise ConfigError(f"{where}: {str(file)!r} cannot be read: {e.strerror}") from None
    except UnicodeDecodeError:
        raise ConfigError(f"{where}: {str(file)!r} is no text") from None
    if not text:
        raise ConfigError(f"{where}: {str(file)!r} is empty")
    return text
