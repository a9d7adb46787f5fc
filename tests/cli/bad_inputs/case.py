"""What one bad input is made of, and the sound folder that it spoils."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from tests.config.files import write

HEADER = "time_s,current_A,coolant_inlet_C,voltage_V,soc,surface_1_C,surface_3_C,surface_5_C"
ROWS = [f"{k},{(k % 7) - 2}.5,2{k % 3}.0,16.4,0.6{k % 10},2{k % 5}.1,2{k % 4}.2,2{k % 3}.3" for k in range(40)]
TABLE = "\n".join([HEADER, *ROWS]) + "\n"
FRAME = "({:.6f}) can0 100#F6FFA4006A32D002\n({:.6f}) can0 18FEF200#00C8320000000000\n"
LOG = "".join(FRAME.format(1.7e9 + k / 10, 1.7e9 + k / 10 + 0.001) for k in range(200))

Edit = bytes | str | tuple[str, str] | Callable[[Path], object] | None


@dataclass(frozen=True)
class Case:
    """One bad input.

    Attributes
    ----------
    name : str
    words : str
        Command line, parted by blanks.
    blame : tuple of str
        What the one line must have in it, whatever the case of its letters.
    edits : mapping of file to what becomes of it
        Its new content; (old, new) text to replace; a function of its path; None to delete it.
    """

    name: str
    words: str
    blame: tuple[str, ...]
    edits: Mapping[str, Edit] = field(default_factory=dict)


def sound(folder: Path) -> None:
    """Write gateway.toml, string_1.toml, vehicle.dbc, bench.csv and drive.log."""
    write(folder)
    (folder / "bench.csv").write_text(TABLE)
    (folder / "drive.log").write_text(LOG)


def spoil(folder: Path, case: Case) -> None:
    """Carry out the edits of a case."""
    for name, edit in case.edits.items():
        file = folder / name
        if edit is None:
            file.unlink()
        elif isinstance(edit, bytes):
            file.write_bytes(edit)
        elif isinstance(edit, str):
            file.write_text(edit, encoding="utf-8")
        elif isinstance(edit, tuple):
            old, new = edit
            text = file.read_text(encoding="utf-8")
            assert old in text, f"{name} has no {old!r}"
            file.write_text(text.replace(old, new, 1), encoding="utf-8")
        else:
            edit(file)
