"""Proposals for the columns of a foreign table, from their names, units and values, for a person to confirm.

No proposal is used without confirmation: `read_table` uses only names and `--columns`.
"""

import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final
from unicodedata import normalize

import numpy as np

from bms_gateway.diagnosis.known_values import correlation
from bms_gateway.report.columns import UNITS, bare_unit, split_unit
from bms_gateway.thermal import Floats

ENOUGH: Final = 0.3
"""Least correlation of the steps of current and voltage for a decision on the sign, as in the direct checks."""
BLOCKS: Final = 60
"""Number of stretches of a record over which charge and current are compared."""
FLOWS: Final = 0.05
"""Share of the largest current below which the string rests."""
ONE_WAY, LEAST_ROWS, MOVED = 0.98, 20, 0.01
"""Least mean sign of a current with one sign, least number of rows, and least relative change of the voltage."""
_ROOM_K: Final = (230.0, 400.0)
_PARTS: Final = 1.5
"""A state of charge with a greater median is in per cent."""
_COARSE_MS: Final = 50.0
"""Whole numbers with steps of at least this size are hardly seconds."""
_MOST: Final = {"current": 2000.0, "voltage": 1500.0}
"""Greater values are in thousandths of the unit."""

_INLET: Final = (
    r"\b(inlet|vorlauf|zulauf|zuluft|eintritt|einlass|t.?in|temp in|coolant|coolant temp|entr(é|e)e"
    r"|k(ü|ue)hl(mittel|wasser|fl(ü|ue)ssigkeit)(vorlauf|zulauf|eintritt|einlass)?)\b"
    r"|\b(wasser|water|glykol|glycol|fluid|medium)( temperatur)? (ein|in|eingang)\b|^t ((km|kw|wasser) )?ein$"
    r"|\bt (fluid|water|glycol)\b|\b(eau|agua|acqua)\b.*\b(entr(é|e)e|entrada|ingresso)\b"
)
_FLUIDS: Final = re.compile(
    r"\b(coolant|cool(ing)?|water|gl[yi][ck]ol|brine|sole|fluid|liquid|medium|antifreeze|\w*wasser|k(ü|ue)hl\w*|eau|agua|acqua"
    r"|liquide|l(í|i)quido|refrigerante|koelvloeistof|km|kw|watergl[yi][ck]ol)\b"
)
_INWARD: Final = re.compile(
    r"\b(in|inlet|feed|supply|entry|entering|incoming|inflow|intake|upstream|vorlauf|vl|zulauf|zufluss|eintritt|einlass|ein"
    r"|eingang|entr(é|e)e|entrada|ingresso|mandata|ida|impulsi(ó|o)n|aller|aanvoer)\b"
)
_OUTWARD: Final = re.compile(
    r"\b(out|outlet|outgoing|outflow|return|exit|leaving|drain|downstream|\w*r(ü|ue)cklauf|rl|ablauf|abfluss|\w*austritt"
    r"|\w*auslass|aus|ausgang|retour|sortie|salida|uscita|ritorno|retorno|vuelta|afvoer)\b"
)
"""Words for the coolant, and for the two ends of its way past the cells."""
_FLOW_OF_HEAT: Final = re.compile(r"\bflow t(emp\w*)?\b|\bt(emp\w*)? flow\b")
"""In English, *flow* beside *return* is where the coolant enters; alone it is its rate."""
_AIR: Final = (
    r"\b(ambient|amb|chamber|umgebung|(klima)?kammer|raum|room|t.?amb|(au(ß|ss)en|umgebungs|raum|kammer)?luft|air"
    r"|au(ß|ss)en(?= temp))\b"
)
_CORE: Final = r"\b(core|kern|mitte|innen|inside|center|centre|c(oe|œ)ur|noyau|n(ú|u)cleo)\b"
_WHEN: Final = (
    r"\b(time|zeit|timestamp|datum|date|uhrzeit|elapsed|test.?time|zeitstempel|messzeit|versuchszeit)\b"
    r"|^ts?( (s|ms|sec|min|h))?$|\btemps( ((é|e)coul(é|e)|test|essai))?\b|\btiempo\b|\btempo\b"
)
_CELL: Final = (
    r"(cell|zelle|zell|surface|surf|oberfl\w*|haut|skin|case|can|mantel|geh(ä|ae)use|temp|temperatur|thermocouple"
    r"|thermoelement|tc|th|ntc|t)"
)
_OF_A_CELL: Final = re.compile(
    r"\d|surf|oberfl|\bt zelle?\b|\bt (cell|case|can)\b|\b(zelle?|cell) t(emp\w*)?\b|\btemp\w* (zelle?|cell)\b"
    r"|skin|haut|mantel|geh(ä|ae)use"
)
"""Words for a surface if no unit says that it is a temperature."""
_OF_THE_BATTERY: Final = re.compile(
    r"\b(t|temp|temperatur\w*)\b.*\b(batt?|battery|batterie|pack|akku|module?|modul)\b"
    r"|\b(batt?|battery|batterie|pack|akku|module?|modul)\b.*\b(t|temp|temperatur\w*)\b"
)
_AN_EXTREME: Final = re.compile(r"\b(max|min|maximum|minimum|highest|lowest|delta|diff)\b")
_ELECTRIC: Final = re.compile(r"\b(voltage|volts?|\w*spannung|current|strom|soc|u|v|i)\b")
_JOINED: Final = re.compile(
    r"\bt(?=(surf\w*|oberfl\w*|zelle?|cell|case|can|geh(ä|ae)use|core|kern|amb|ambient|umg\w*|luft|air|inlet|cool\w*|fluid|water|glycol"
    r"|k(ü|ue)hl\w*|vorlauf|skin|haut)\b)"
)
"""A t for temperature that is joined with the next word, such as `tsurf`."""
_COMPOUND: Final = re.compile(r"(?<=[a-zäöüß]{3})(s|(?<!s))(?=temp(eratur(en)?)?\b)")
"""Where a German compound of a temperature is parted, such as `vorlauftemperatur` and `umgebungstemperatur`."""
_OF_A_STEP: Final = re.compile(r"\b(step|schritt|cycle|zyklus)\b")
"""Words for a time that starts anew within a test."""
_OF_ALL: Final = re.compile(r"\b(total|test|gesamt|date|datum|elapsed)\b")
ONES: Final = (
    ("time_s", "time", re.compile(_WHEN)),
    (
        "current_A",
        "current",
        re.compile(
            r"\b(current|strom|i|ib|i.?bat(t|tery)?|amps?|amperes?|courant|corriente|corrente|pack.?current"
            r"|(pack|batterie|gesamt|lade|entlade|last|strang|modul)strom)\b"
        ),
    ),
    ("coolant_inlet_C", "temperature", re.compile(f"{_INLET}|{_AIR}")),
    (
        "soc",
        "soc",
        re.compile(
            r"\b(soc|ladezustand|state of charge|charge level|ladestand|(é|e)tat de charge|estado de carga"
            r"|stato di carica)\b"
        ),
    ),
    ("coolant_flow_m3_s", "flow", re.compile(r"\b(flow|durchfluss|volumenstrom|flow rate|d(é|e)bit|volume flow)\b")),
    (
        "voltage_V",
        "voltage",
        re.compile(
            r"\b(voltage|spannung|u|v|volts?|tension|ewe|ecell|pack.?voltage"
            r"|(pack|gesamt|klemmen|strang|batterie|modul|akku)spannung)\b"
        ),
    ),
)
"""Quantities that a string has once: our name, the quantity, and the words of other tools."""
_NOT: Final = re.compile(
    r"\b(outlet|\w*(r(ü|ue)cklauf|auslass|austritt)|abluft|power|leistung|energy|energie|error|fehler|status)\b"
)
_NUMBER: Final = re.compile(r"(\d+)(?!.*\d)")
_NUMBER_OF_CELL: Final = re.compile(r"\b(?:cell|zelle|zell)[\s_#.:-]*(?:no|nr)?[\s_#.:-]*(\d+)")
_CHARGE: Final = re.compile(
    r"\b(ladung|charge|f(ü|ue)llstand|akku|batt?|batterie|battery|bater(í|i)a|batteria|bms|pack|gauge|remaining"
    r"|restkapazit(ä|ae)t)\b"
)
"""Words for the state of charge of a column in per cent."""
_OTHER_SHARE: Final = re.compile(
    r"\b(soh|health|gesundheit|humidity|feuchte|throttle|pedal|duty|fan|l(ü|ue)fter|pump\w*|torque|drehmoment|capability"
    r"|limit|target|soll|depth|dod|aging|ageing|imbalance)\b"
)
"""Words for other quantities in per cent."""
_OF_CELLS_V: Final = re.compile(
    r"\b(v|u) ?(cells?|zellen?)\b|\bcells? (v|u|volt\w*)\b|\bzell(en)?spannung\b|\bcells?\b.*volt"
)
_A_MEAN: Final = re.compile(
    r"\b(mean|avg|ave|average|mittel\w*|durchschnitt\w*|moy(enne?)?|media|promedio|gem(iddeld)?)\b"
)
_CHARGING_RISES: Final = re.compile(
    r"\b(laden|ladung|charge|charging|chg)\b[ :=]*(\+|pos)|\+[ :=]*(laden|ladung|charge|charging|chg)\b"
    r"|\b(entladen|entladung|discharge|discharging)\b[ :=]*(neg|[-\u2212](?=\s*([\])/,;]|$)))"
    r"|^(?!.*(discharge|entlade|d(é|e)charge|descarga|scarica)).*\b(ladestrom|charg(e|ing).?current|courant de charge"
    r"|corriente de carga|corrente di carica)\b"
)
"""Words in the name of a current that is positive while it charges."""


@dataclass(frozen=True, slots=True)
class Guess:
    """Proposal for a column.

    Attributes
    ----------
    ours : str
        Our name.
    unit : str or None
        Unit guessed from the values, if the file states none.
    flip : bool
        Whether the sign is probably the opposite one.
    why : str
    """

    ours: str
    unit: str | None = None
    flip: bool = False
    why: str = ""


def plain(name: str) -> str:
    """Write a column's name without its unit, in small letters, with blanks between words.

    Examples
    --------
    >>> plain("T_Zelle_03 [°C]"), plain("Kühlmittel-Vorlauf/°C"), plain("cellTemp3")
    ('t zelle 03', 'kühlmittel vorlauf', 'cell temp 3')
    >>> plain("Tsurf"), plain("TZelle3"), plain("total"), plain("Vorlauftemperatur")
    ('t surf', 't zelle 3', 'total', 'vorlauf temperatur')
    """
    base = re.sub(r"(?<=[a-zäöü])(?=[A-Z])", " ", normalize("NFC", split_unit(name)[0]))
    base = re.sub(r"(?<=[a-zA-Zäöü])(?=\d)", " ", re.sub(r"[_\W]+", " ", base))
    return _COMPOUND.sub(" ", _JOINED.sub("t ", base.strip().lower()))


def lookalike(ours: str, names: Sequence[str]) -> str | None:
    """Return the only column that matches these words, or the first time of a whole test; None if it is not clear."""
    pattern = next((p for name, _, p in ONES if name == ours), None)
    near = [n for n in names if pattern is not None and pattern.search(plain(n))]
    if ours == "time_s" and len(near) > 1:
        near = [n for n in near if untimely(n, None) == 0][:1]
    return near[0] if len(near) == 1 else None


def guesses(
    names: Sequence[str],
    below: Sequence[str] | None,
    taken: Mapping[str, str],
    values: Mapping[str, Floats],
    dated: str,
    told: Collection[str] = (),
) -> dict[str, Guess]:
    """Make proposals for the columns whose names are not ours.

    Parameters
    ----------
    names : sequence of str
        Of the file's columns.
    below : sequence of str, optional
        Row of units below them.
    taken : mapping
        Columns that are already known: column of the file by our name.
    values : mapping
        First values of the columns with numbers.
    dated : str
        Column that has dates; may be empty.
    told : collection of str
        Our names of which the user has said where they are.

    Returns
    -------
    dict of the file's column to Guess
    """
    units = dict(zip(names, map(bare_unit, below), strict=True)) if below is not None else {}
    free = [n for n in names if n not in taken.values() and (n in values or n == dated)]
    kind = {n: _quantity(split_unit(n)[1] or units.get(n) or "") for n in free}
    found: dict[str, Guess] = {}
    if dated and "time_s" not in taken:
        found[dated] = Guess("time_s", why="its cells are times")
    for ours, quantity, pattern in ONES:
        if ours in taken or any(g.ours == ours for g in found.values()):
            continue
        fits = [n for n in free if n not in found and kind[n] in (None, quantity) and _called(pattern, ours, n)]
        if quantity == "temperature":
            fits = _inlets(fits, [n for n in free if n not in found], kind)
            fits = [n for n in fits if not re.search(_CORE, plain(n))]
        if not fits and quantity in ("current", "time", "flow"):  # only its unit identifies it
            fits = [n for n in free if n not in found and kind[n] == quantity and not _NOT.search(plain(n))][:1]
        if not fits and ours == "soc":
            fits = [n for n in free if n not in found and kind[n] == quantity and _of_the_charge(plain(n))][:1]
        if fits:
            rank = {n: untimely(n, values.get(n)) if ours == "time_s" else 0 for n in fits}
            best = min(fits, key=lambda n: (rank[n], kind[n] is None, _late(ours, n), names.index(n)))
            found[best] = Guess(ours, _unit_of(quantity, values.get(best), kind[best]), why="by its name")
    for what, quantity in (("core", "temperature"), ("surface", "temperature"), ("cell_voltage", "voltage")):
        found |= _cells(what, quantity, [n for n in free if n not in found], kind, values, taken)
    found |= _of_all_cells(found, [n for n in free if n not in found], kind, values, taken)
    return _signed(found, taken, values, told)


def _called(pattern: re.Pattern[str], ours: str, name: str) -> bool:
    text = plain(name)
    numbered = _NUMBER.search(text) is not None and ours in ("voltage_V", "time_s")
    return bool(pattern.search(text)) and not _NOT.search(text) and not numbered


def _inlets(fits: Sequence[str], free: Sequence[str], kind: Mapping[str, str | None]) -> list[str]:
    """Add columns of a coolant where it enters, and leave out those where it leaves."""
    found = [n for n in free if n not in fits and kind[n] in (None, "temperature") and _enters(plain(n), kind[n])]
    return [n for n in (*fits, *found) if not _OUTWARD.search(plain(n))]


def _enters(text: str, quantity: str | None) -> bool:
    rate = quantity == "temperature" and re.search(r"\bflow\b", text)
    inward = _INWARD.search(text) or _FLOW_OF_HEAT.search(text) or rate
    return bool(_FLUIDS.search(text) and inward)


def _of_the_charge(text: str) -> bool:
    """Whether a column in per cent is the state of charge: by a word for it, and by none for another share."""
    return bool(_CHARGE.search(text)) and not _NOT.search(text) and not _OTHER_SHARE.search(text)


def _of_all_cells(
    found: Mapping[str, Guess],
    free: Sequence[str],
    kind: Mapping[str, str | None],
    values: Mapping[str, Floats],
    taken: Mapping[str, str],
) -> dict[str, Guess]:
    """Use a mean voltage of the cells, or a temperature of the battery, where no cell has its own."""
    known = [*taken, *(g.ours for g in found.values())]
    more = {} if any("voltage_" in ours for ours in known) else _mean_voltage(free, kind, values)
    if not any(ours.startswith("surface_") for ours in known):
        more |= _of_the_battery(free, kind, values)
    return more


def _mean_voltage(
    free: Sequence[str], kind: Mapping[str, str | None], values: Mapping[str, Floats]
) -> dict[str, Guess]:
    """Use the mean voltage of the cells as that of the first one, if the table has no other voltage."""
    for n in free:
        text = plain(n)
        if kind[n] in (None, "voltage") and _OF_CELLS_V.search(text) and _A_MEAN.search(text):
            why = "the mean voltage of a cell: times their number it is that of the string"
            return {n: Guess("cell_voltage_1_V", _unit_of("voltage", values.get(n), kind[n]), why=why)}
    return {}


def _late(ours: str, name: str) -> bool:
    """Whether a column only replaces a missing inlet, such as an air temperature."""
    return ours == "coolant_inlet_C" and not re.search(_INLET, plain(name))


def untimely(name: str, t: Floats | None) -> int:
    """Judge a column of times: 0 for the time of a whole test, 1 for another, 2 for one that does not go forward.

    Examples
    --------
    >>> untimely("Total Time", np.arange(3.0)), untimely("Time", np.arange(3.0)), untimely("Time", np.array([1.0, 0]))
    (0, 1, 2)
    """
    given = t[np.isfinite(t)] if t is not None else np.empty(0)
    if (np.diff(given) < 0.0).any() or _OF_A_STEP.search(plain(name)):
        return 2
    return 0 if _OF_ALL.search(plain(name)) else 1


def _quantity(unit: str) -> str | None:
    """Return the quantity of a unit; None without a unit, "else" for a unit that is not used here."""
    if not unit:
        return None
    known = [q for q, units in UNITS.items() if unit in units]
    return known[0] if known else None if not re.search(r"[A-Za-z%°]", unit) else "else"


def _cells(
    what: str,
    quantity: str,
    free: Sequence[str],
    kind: Mapping[str, str | None],
    values: Mapping[str, Floats],
    taken: Mapping[str, str],
) -> dict[str, Guess]:
    """Give each cell the number in its column's name, or its position in the order."""
    suffix = "V" if what == "cell_voltage" else "C"
    free = [n for n in free if not (_FLUIDS.search(plain(n)) and _OUTWARD.search(plain(n)))]
    if what == "cell_voltage":
        pattern = r"\b(cell|zelle?|zell\w*|u|v)\b"
    else:
        pattern = _CORE if what == "core" else rf"\b{_CELL}\b"
    mine = [
        n for n in free if kind[n] in (None, quantity) and re.search(pattern, plain(n)) and not _NOT.search(plain(n))
    ]
    if what == "cell_voltage":  # a column without a unit or a number may be anything
        mine = [n for n in mine if kind[n] == quantity and _NUMBER.search(plain(n))]
    elif what == "surface":
        mine = [n for n in mine if kind[n] == quantity or _heat_of_a_cell(plain(n))]
        series = _series([n for n in free if kind[n] == quantity and not _NOT.search(plain(n))])
        if not mine:
            mine = series or [n for n in free if kind[n] == quantity and not _NOT.search(plain(n))]
    numbers, why = _numbers([plain(n) for n in mine]), "by its name and number"
    if numbers is None:
        numbers, why = list(range(1, len(mine) + 1)), "by its name, and its cell by the order of the columns"
    given = {f"{what}_{k}_{suffix}": n for k, n in zip(numbers, mine, strict=True)}
    return {
        n: Guess(ours, _unit_of(quantity, values.get(n), kind[n]), why=why)
        for ours, n in given.items()
        if ours not in taken
    }


def _numbers(texts: Sequence[str]) -> list[int] | None:
    """Read the cell's number in each name; None if the numbers do not tell the names apart.

    The number after the word for a cell counts first, then the last number, then the others: a name may contain that
    of a module or the number of all cells, too. Cells that count from 0 are numbered from 1.

    Examples
    --------
    >>> _numbers(["temp cell 2 module 3", "temp cell 4 module 3"]), _numbers(["t surf 2 module 7", "t surf 5 module 7"])
    ([2, 4], [2, 5])
    >>> _numbers(["cell 0 of 12", "cell 5 of 12"]), _numbers(["surface", "skin"])
    ([1, 6], None)
    """
    of_cell = [m[1] if (m := _NUMBER_OF_CELL.search(text)) else "" for text in texts]
    of_name = [re.findall(r"\d+", text) for text in texts]
    least = min(map(len, of_name), default=0)
    last = [found[-1] if found else "" for found in of_name]  # one name in a series may have none
    for some in (of_cell, last, *([found[k] for found in of_name] for k in range(least))):
        numbers = [int(x[-9:]) if x else 0 for x in some]
        apart = len(set(numbers)) == len(numbers)
        if apart and any(some) and not (0 in numbers and len(texts) == 1) and (some is last or all(some)):
            return [k + 1 for k in numbers] if 0 in numbers else numbers
    return None


def _series(names: Sequence[str]) -> list[str]:
    """Return the names that differ from another one only by their number, such as those of sensors."""
    stems = [_NUMBER.sub("#", plain(n)) for n in names]
    return [n for n, stem in zip(names, stems, strict=True) if "#" in stem and stems.count(stem) > 1]


def _of_the_battery(
    free: Sequence[str], kind: Mapping[str, str | None], values: Mapping[str, Floats]
) -> dict[str, Guess]:
    """Use the only temperature of a battery as a surface, if no cell has a temperature of its own."""
    for n in free:
        text = plain(n)
        if kind[n] in (None, "temperature") and _OF_THE_BATTERY.search(text) and not _AN_EXTREME.search(text):
            why = "a temperature of the battery: no cell has its own"
            return {n: Guess("surface_1_C", _unit_of("temperature", values.get(n), kind[n]), why=why)}
    return {}


def _heat_of_a_cell(text: str) -> bool:
    return bool(_OF_A_CELL.search(text)) and not _ELECTRIC.search(text)


def _unit_of(quantity: str, x: Floats | None, stated: str | None) -> str | None:
    """Guess a unit from the size of the values, if the file states none and it is not the usual one."""
    given = x[np.isfinite(x)] if x is not None else np.empty(0)
    if stated is not None or len(given) < 2:
        return None
    if quantity == "soc" and is_percent(given):
        return "%"
    if quantity == "temperature" and _ROOM_K[0] < float(np.median(given)) < _ROOM_K[1]:
        return "K"
    if quantity == "time" and (given == np.round(given)).all() and float(np.median(np.diff(given))) >= _COARSE_MS:
        return "ms"
    large = float(np.abs(given).max()) > _MOST.get(quantity, np.inf)
    return {"current": "mA", "voltage": "mV"}[quantity] if large else None


def is_percent(soc: Floats) -> bool:
    """Whether a state of charge is in per cent."""
    return float(np.nanmedian(soc)) > _PARTS


def _signed(
    found: dict[str, Guess], taken: Mapping[str, str], values: Mapping[str, Floats], told: Collection[str]
) -> dict[str, Guess]:
    """Change the sign of a current with which voltage or charge rise: proposed, or known by a name such as Current(A).

    The sign of `current_A` is that of its definition, and one that the user has told is not guessed.
    """
    where = {**{g.ours: n for n, g in found.items()}, **taken}
    column = where.get("current_A")
    if column in (None, "current_A") or "current_A" in told:
        return found
    byname = found.get(column, Guess("current_A", why="by its name"))
    voltages = [where[o] for o in where if o == "voltage_V" or o.startswith("cell_voltage_")]
    I = values.get(column)  # noqa: E741 - the paper's symbol
    V, soc = values.get(voltages[0]) if voltages else None, values.get(where.get("soc", ""))
    if why := rises(I, V, soc):
        found[column] = replace(byname, flip=True, why=f"{byname.why}; {why}: charge is positive there")
    elif _CHARGING_RISES.search(normalize("NFC", column).lower()) and not rises(None if I is None else -I, V, soc):
        found[column] = replace(byname, flip=True, why=f"{byname.why}, which says that charge is positive")
    return found


def rises(I: Floats | None, V: Floats | None, soc: Floats | None) -> str:  # noqa: E741 - the paper's symbol
    """Say what rises with a discharge current and should fall; empty if nothing does."""
    if I is None:
        return ""
    if V is not None and correlation(np.diff(I), np.diff(V)) > ENOUGH:
        return "the voltage rises with it"
    if V is not None and (one_way := _one_way(I, V)):
        return one_way
    size = max(len(I) // BLOCKS, 1)
    if V is None and soc is not None and (count := len(I) // size) >= 5:
        moved = I[: (count - 1) * size].reshape(count - 1, size).mean(axis=1)
        if correlation(moved, np.diff(soc[: count * size : size])) > ENOUGH:
            return "the SOC rises with it"
    return ""


def _one_way(current: Floats, V: Floats) -> str:
    """Do the same for a current with one sign, such as a constant discharge: the voltage follows the charge."""
    both = np.isfinite(current) & np.isfinite(V)
    flows = both & (np.abs(current) > FLOWS * np.max(np.abs(current[both]), initial=0.0))
    sign, over = float(np.sign(current[flows]).mean()) if flows.any() else 0.0, V[flows]
    if len(over) < LEAST_ROWS or abs(sign) < ONE_WAY:
        return ""
    tenth = len(over) // 10
    moved = float(over[-tenth:].mean() - over[:tenth].mean()) / float(np.abs(over).mean())
    if sign * moved < MOVED:
        return ""
    return "the voltage rises while it is positive" if moved > 0.0 else "the voltage falls while it is negative"
