"""The road a user has: a table is encoded to frames of our DBC, `analyze` reads them, its folder says what was stated.

The commands run in a Python of their own from the checkout that is judged, so that the commit before goes the same way.
"""

import csv
import json
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tests.benchmarks.honesty_case import SPANS

ROOT = Path(__file__).resolve().parents[2]

COMMANDS = """
import contextlib, json, sys, time
from bms_gateway.cli.main import main
with contextlib.redirect_stdout(sys.stderr):
    for words in json.loads(sys.argv[1]):
        if code := main(words):
            print(words[0], file=sys.__stdout__)
            sys.exit(code)
print(time.process_time())
"""
CALM = ("good", "estimated")
"""Qualities of a core that nobody doubts: measured at its surface, or reckoned from its neighbours."""
FLAGS = ("mismatch", "thermocouple", "cooling", "current", "ageing", "sensor", "skew", "unproven")
"""Codes of events that say that numbers of a string or a cell are not to be trusted as they stand."""
DOUBTS = (*FLAGS, "estimate", "unexplained_heat", "missing_heat", "runaway")
"""Names of alerts that say so."""


@dataclass(frozen=True)
class Stated:
    """What was stated of the cores of one string.

    Attributes
    ----------
    time_s : ndarray (K,)
        As in the table that was encoded.
    core, sd : ndarray (K, n)
        °C, K; NaN where none was stated.
    told : ndarray of bool (K, n)
        Where a flag stood, an alert was raised or the quality was neither good nor estimated.
    since : dict of str to float
        What was told from minute ten on, and when first.
    seconds : float
        CPU of `encode` and `analyze`.
    """

    time_s: np.ndarray
    core: np.ndarray
    sd: np.ndarray
    told: np.ndarray
    since: dict[str, float]
    seconds: float


class RefusedError(Exception):
    """The measurements speak against the effect that was to be added: nothing was written."""


def drive_through(root: Path, table: Path, config: Path, out: Path, after: str = "") -> Stated:
    """Encode a table and analyze it by the package of the checkout `root`.

    Parameters
    ----------
    after : str
        `fit` to fit the config's model to the table first, or the name of an effect to add to it.

    Raises
    ------
    RuntimeError
        A command failed; with what it said.
    RefusedError
        The effect is not added.
    """
    log = out.with_suffix(".log")
    commands = [
        *_changed(config.parent / "cell.toml", table, after),
        ["encode", str(table), "--config", str(config), "--out", str(log)],
        ["analyze", str(log), "--config", str(config), "--out", str(out)],
    ]
    done = subprocess.run(
        [sys.executable, "-c", COMMANDS, json.dumps(commands)], cwd=root, capture_output=True, text=True, check=False
    )
    if done.returncode == 1 and done.stdout.split() == ["add"]:
        raise RefusedError
    if done.returncode:
        raise RuntimeError(f"{table.stem} by {root.name}: {done.stderr.strip()[-500:]}")
    log.unlink()
    return stated(out, float(done.stdout.split()[-1]))


def _changed(model: Path, table: Path, after: str) -> list[list[str]]:
    """Commands that replace a model file by what comes of it on the table."""
    if not after:
        return []
    plain = model.with_name("plain.toml")
    model.rename(plain)
    files = ["--model", str(plain), "--out", str(model)]
    return [["fit", str(table), *files] if after == "fit" else ["add", after, "--data", str(table), *files]]


def stated(folder: Path, seconds: float = 0.0) -> Stated:
    """Read the folder that `analyze` leaves; columns and files that a version does not write are not asked for."""
    with (folder / "estimates.csv").open(newline="") as f:
        rows = list(csv.DictReader(f))
    cells = max(int(r["cell"]) for r in rows)

    def column(name: str) -> np.ndarray:
        return np.array([float(r[name] or "nan") for r in rows]).reshape(-1, cells)

    time_s = column("time_s")[:, 0]
    late = time_s >= time_s[0] + SPANS["settled"]
    quality = np.array([r["quality"] for r in rows]).reshape(-1, cells)
    told = ~np.isin(quality, CALM)
    since = {}
    for q in np.unique(quality[late][told[late]]).tolist():
        since[f"quality {q}"] = float(time_s[late & (quality == q).any(axis=1)][0])
    for begin, end, cell, name in _raised(folder):
        at = (time_s >= begin) & (time_s < end)
        told[np.ix_(at, np.arange(cells) if cell is None else [cell - 1])] = True
        if (at & late).any():
            since[name] = min(begin, since.get(name, np.inf))
    return Stated(time_s, column("core_C"), column("core_sd_K"), told, since, seconds)


def _raised(folder: Path) -> list[tuple[float, float, int | None, str]]:
    """From when, until when, of which cell and under which name something was told: flags, then alerts."""
    found = []
    for e in _lines(folder / "events.jsonl"):
        if e["code"] in FLAGS and e["level"] in ("warning", "notice", "alarm", "error"):
            found.append((e["time_s"], (e["code"], e["string"], e["cell"]), e["level"] != "notice"))
    for a in _lines(folder / "alerts.jsonl"):
        if a["name"] in DOUBTS:
            found.append((a["time_s"], (f"alert {a['name']}", a["string"], a["cell"]), a["state"] != "over"))
    spans, open_since = [], {}
    for at, key, stands in sorted(found, key=lambda x: x[0]):
        if stands:
            open_since.setdefault(key, at)
        elif key in open_since:
            spans.append((open_since.pop(key), at, key[2], key[0]))
    return spans + [(at, np.inf, key[2], key[0]) for key, at in open_since.items()]


def _lines(path: Path) -> list[dict]:
    return [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []
