"""Files of packs, as a user has them: a log with an effect hidden, and the nominal model."""

from dataclasses import dataclass
from pathlib import Path

from tests.truth.hidden import Scenario, make_logs


@dataclass(frozen=True)
class Pack:
    """Folder, table with an effect hidden, table without, nominal model, and the true parameters."""

    folder: Path
    hidden: Path
    clean: Path
    model: Path
    truth: dict

    @property
    def words(self) -> tuple[str, ...]:
        return str(self.hidden), "--model", str(self.model)


def pack(folder: Path, effect="entropic_heat", **changes) -> Pack:
    common = {"seed": 21, "seconds": 1500, "cells": 3, "sensors": (1, 3), "noise": 0.05} | changes
    hidden, clean = make_logs([Scenario(effects={effect: ("strong", None)}, **common), Scenario(**common)])
    hidden.write_csv(folder / "hidden.csv")
    clean.write_csv(folder / "clean.csv")
    (folder / "pack.toml").write_text(clean.model)
    return Pack(folder, folder / "hidden.csv", folder / "clean.csv", folder / "pack.toml", clean.pack)
