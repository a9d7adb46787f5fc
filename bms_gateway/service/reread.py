"""A config read again in a process of its own, so that no content of its files can disturb the service.

A file that takes too long or too much memory, or crashes its reader, does so in the child. Meanwhile the loop
continues; it gets a complete engine, and only has to transfer the state.
"""

import asyncio
import logging
import os
import pickle
import sys
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO, Final

from bms_gateway import __version__
from bms_gateway.errors import ConfigError, GatewayError
from bms_gateway.service.memory import first_to_go
from bms_gateway.service.signals import signal_name

if TYPE_CHECKING:
    from bms_gateway.config.schema import GatewayConfig
    from bms_gateway.engine import Engine

CHILD: Final = (sys.executable, "-P", "-m", "bms_gateway.service.reread")  # independent of the working directory
OTHER: Final = "another version of the program has been installed: restart the service"
PATIENCE_S: Final = 25.0
"""Time limit for a child on a busy machine or a file system that hangs; systemd gives a reload 30 s."""


@dataclass(frozen=True, slots=True)
class Reread:
    """A valid config.

    Attributes
    ----------
    config : GatewayConfig
    packed : bytes
        Its engine, pickled.
    """

    config: "GatewayConfig"
    packed: bytes

    def engine(self) -> "Engine":
        """Return the engine, a new one each time."""
        try:
            made: Engine = pickle.loads(self.packed)  # noqa: S301 (written by our own child)
        except (AttributeError, ImportError, TypeError, ValueError, pickle.UnpicklingError) as e:
            raise ConfigError(f"{OTHER} ({e})") from None
        return made


async def reread(path: Path) -> Reread:
    """Read a config with all its files, and make its engine, in a child process.

    Parameters
    ----------
    path : Path

    Returns
    -------
    Reread

    Raises
    ------
    ConfigError
        As for `load_config`; or the child did not end, or crashed.
    """
    try:
        # a group of its own: an interrupt from the keyboard is for the service, which then ends its child
        child = await asyncio.create_subprocess_exec(*CHILD, str(path), stdout=asyncio.subprocess.PIPE, process_group=0)
    except OSError as e:
        raise ConfigError(f"{path}: no process could be started to read it: {e.strerror}") from None
    try:
        async with asyncio.timeout(PATIENCE_S):
            answer, _ = await child.communicate()
    except TimeoutError:
        raise ConfigError(f"{path}: reading it came to no end in {PATIENCE_S:g} s") from None
    finally:
        if child.returncode is None:
            with suppress(ProcessLookupError):
                child.kill()
            await child.communicate()  # until it has ended, with its pipe
    if child.returncode:
        how = signal_name(-child.returncode) if child.returncode < 0 else f"status {child.returncode}"
        raise ConfigError(f"{path}: the process that read it ended with {how}")
    version, _, content = answer.partition(b"\n")
    if version != __version__.encode():  # its classes may be others
        raise ConfigError(f"{path}: {OTHER}")
    try:
        found: Reread | str = pickle.loads(content)  # noqa: S301 (written by our own child)
    except (AttributeError, ImportError, TypeError, ValueError, pickle.UnpicklingError):
        raise ConfigError(f"{path}: {OTHER}") from None
    if isinstance(found, str):
        raise ConfigError(found)
    return found


def read_for_parent(path: Path, out: BinaryIO) -> None:
    """Read a config and write the result, a `Reread` or the error line: the work of the child."""
    from bms_gateway.config.load import load_config

    found: Reread | str
    try:
        loaded = load_config(path)
        found = Reread(loaded.config, pickle.dumps(loaded.engine()))
    except GatewayError as e:
        found = str(e)
    out.write(f"{__version__}\n".encode() + pickle.dumps(found))


if __name__ == "__main__":
    from bms_gateway.service import reread as itself  # pickle must find its classes under their own name

    first_to_go()
    logging.disable()  # `check` shows what a DBC parser logs
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    itself.read_for_parent(Path(sys.argv[1]), sys.stdout.buffer)
