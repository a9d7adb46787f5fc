"""Meaning of the names and units of signals: words of the field, in the languages of DBC files."""

import re
from collections.abc import Iterable, Mapping
from functools import lru_cache
from types import MappingProxyType
from typing import Final, NamedTuple

from bms_gateway.frames.signal_info import SignalInfo

_RUN_ON: Final = re.compile(r"(bms|bmu|bcu|bmc|b?ess|pack|string|rack|stack|batt?|hvb|akku)([a-h])", re.I)
"""A letter that stands for a number and follows its word without a separator: BMSA, BMSB."""
_CAPITALS: Final = re.compile(r"([A-Z]{3,})([A-H])")
"""The same at the end of any word in capitals, for the comparison of names."""
_PARTS: Final = re.compile(r"So[CHE](?![a-z])|[A-Z]+(?![a-z])|[A-Z]?[a-z]+|\d+")


def _list(text: str) -> tuple[str, ...]:
    return tuple(text.split())


CURRENT: Final = _list("""
    current curr cur strom stroom amps amp ampere courant corrente corriente i ibat ibatt ipack idc ihv istrom ampe
    crnt dianliu
    """)
VOLTAGE: Final = _list("""
    voltage volt volts spannung spanning tension tensione tensao u v ubat ubatt upack vbat vbatt vpack uhv vhv
    udc vdc vcell ucell cellv uzelle spg vltg dianya
    """)
TEMPERATURE: Final = _list("""
    temperature temp temps tmp temperatur temperatuur temperatura thermistor therm ntc tc rtd thermocouple t
    tcell tzelle tmod tsurf tb tz wendu
    """)
CHARGE: Final = _list("""
    soc rsoc socui ladezustand stateofcharge sysoc chargelevel laadtoestand etatcharge dianliang
    """)
DISCHARGE: Final = _list("""
    discharge discharging dischg dischrg dschg disch dchg dchrg dsg dsch dis entlade entladen entladung decharge
    descarga scarica ontladen ontlaad fangdian
    """)
CHARGING: Final = _list("""
    charge charging chg chrg chr lade laden ladung recharge carga carica opladen laad chongdian
    """)
FLOW: Final = _list("flow durchfluss volumenstrom flowrate debit")
PACK: Final = _list("""
    pack batt battery bat hv hvb hvbat traction main total bus bms bmu bcu bmc string ess ress lb dc akku accu
    accumulator sme batterie batterij bateria batteria ibat ibatt ipack idc ihv upack vpack link sum gesamt stack
    dianchi zong
    """)
CELL: Final = _list("cell cells zelle zell vcell ucell cellv uzelle zellen cv tcell cel cella celda cellule danti")
SENSED: Final = _list("""
    cell cells zelle zell cel cella celda cellule module mod modul modulo batt battery bat pack channel probe
    thermistor ntc tc surface surf skin bms bmu stack segment seg sensor thermocouple hvb akku tcell tmod tsurf
    oberflaeche lb cmu string batterie batterij bateria batteria danti dianchi tb tz
    """)
OTHER_THINGS: Final = _list("""
    motor inv inverter mc igbt mosfet mos gate driver board pcb cpu mcu chip water oil cabin interior evap
    evaporator ac heater ptc charger obc dcdc brake tire tyre rotor stator contactor fuse shunt exhaust engine
    radiator pump fan phase lv aux lipo wave rtd steering wheel torque lamp seat afe condenser compressor mg relay
    busbar charge qc hist histdata wakeup setting dash intake hot stall shudder ref imd isolation iso insulation
    throttle cpi mot moteur motore onduleur inversor inverseur chargeur cargador caricatore charge lader ladegeraet
    wechselrichter umrichter habitacle innenraum innen kabine cabine cabina huile olie olio aceite reifen bremse frein
    getriebe evse ccs plug connector socket heizung heizer heizkreis dianji diankong chongdian phasen fazowy
    brd bd fet tarjeta carte karte platine leiterplatte scheda placa heatsink kuehlkoerper elektronik electronics elek
    balancer transmission gearbox hydraulic washer
    """)
NOT_MEASURED: Final = _list("""
    limit limits lim max min maximum minimum allowed avail available request req cmd command target setpoint set
    soll fault peak hist histdata threshold permissible capability limiter mode status flag error counter power
    integrated id iq latch fail warning alarm delta diff highest lowest desired estimated crc checksum offset mux
    number num count index nr state type health enable ctrl control sp derate rated nominal energy idx select
    spread imbalance quality valid
    """)
STATISTIC: Final[Mapping[str, str]] = MappingProxyType(
    {
        **dict.fromkeys(
            _list("max maximum highest hottest hi high maxi tx ux vx hoechste hoogste massima maxima zuigao"), "max"
        ),
        **dict.fromkeys(
            _list("min minimum lowest coldest lo low mini tn un vn niedrigste laagste minima zuidi"), "min"
        ),
        **dict.fromkeys(
            _list("""
                avg ave average mean pingjun mittel mittelwert durchschnitt moy moyen moyenne gem gemiddeld media
                promedio
                """),
            "mean",
        ),
    }
)
COOLANT: Final = _list("""
    coolant cool inlet water eau acqua agua refroidissement entree entrada ingresso liquide refrigerante
    koelvloeistof aanvoer vorlauf kuehlmittel kuhlmittel kuehl kuhl glycol in entry supply cooling liquid lengque
    lengqueye jinshui jinkou eintritt einlass zulauf zuluft brine sole antifreeze wasser
    kuehlwasser waterglycol
    """)
INWARD: Final = _list("""
    inlet in vorlauf supply entry entree entrada ingresso aanvoer jinshui jinkou eintritt einlass zulauf zuluft feed
    inflow intake upstream incoming entering mandata impulsion vl
    """)
OUTWARD: Final = _list("""
    outlet out return ruecklauf austritt auslass ablauf abluft exit back retour sortie salida uscita chushui chukou
    huishui rl outflow downstream outgoing leaving drain abfluss ritorno retorno vuelta afvoer
    """)
LEVEL: Final = _list("gauge level remaining capacity fuel fuellstand restkapazitaet nivel livello niveau")
"""Words that mean the charge only for a ratio of the battery which falls as current is drawn."""
WHOLE_WORDS: Final = _list("feedback drawback setback playback payback rollback fallback")
"""Words that are not cut into others."""
AMBIENT: Final = _list("""
    ambient outside amb air umgebung aussen chamber exterieure exterieur esterna ambiente buiten env environment oat
    ots huanjing aussentemp aussentemperatur aussenluft umgebungstemperatur umg luft
    """)


class Unit(NamedTuple):
    """Meaning of a unit as a DBC prints it: its quantity, and SI (°C) = factor · value + offset."""

    family: str
    factor: float
    offset: float


_F = (5 / 9, -160 / 9)
UNITS: Final[Mapping[str, Unit]] = MappingProxyType(
    {
        **{u: Unit("current", 1.0, 0.0) for u in ("a", "amp", "amps", "amper", "ampere", "amperes", "adc")},
        **{u: Unit("current", 1e-3, 0.0) for u in ("ma", "mamp", "mamps", "milliamp", "milliamps", "milliampere")},
        "ka": Unit("current", 1e3, 0.0),
        "da": Unit("current", 0.1, 0.0),
        **{u: Unit("voltage", 1.0, 0.0) for u in ("v", "volt", "volts", "vdc")},
        **{u: Unit("voltage", 1e-3, 0.0) for u in ("mv", "mvolt", "mvolts", "millivolt", "millivolts")},
        "kv": Unit("voltage", 1e3, 0.0),
        **{
            u: Unit("temperature", 1.0, 0.0)
            for u in ("c", "degc", "°c", "celsius", "dc", "cel", "grad c", "grdc", "ºc")
        },
        # the last two are ℃ in GBK and in UTF-8, read as Windows-1252
        **{u: Unit("temperature", 1.0, 0.0) for u in ("℃", "¡æ", "„ƒ")},
        **{u: Unit("temperature", 1.0, -273.15) for u in ("k", "kelvin", "degk")},
        **{u: Unit("temperature", *_F) for u in ("f", "degf", "°f", "fahrenheit", "ºf")},
        **{u: Unit("share", 1e-2, 0.0) for u in ("%", "percent", "pct", "prozent")},
        "m3/s": Unit("flow", 1.0, 0.0),
        "m3/h": Unit("flow", 1 / 3600, 0.0),
        "l/s": Unit("flow", 1e-3, 0.0),
        "l/h": Unit("flow", 1e-3 / 3600, 0.0),
        **{u: Unit("flow", 1e-3 / 60, 0.0) for u in ("l/min", "lpm", "lmin")},
    }
)
OTHER_UNITS: Final = frozenset(
    _list(
        """
        rpm 1/min nm n/m w kw mw hp wh kwh ah mah s sec second seconds ms us min h hours days hz khz kph km/h kmh mph
        m/s m/s2 m/s^2 g kg km m mm cm bar mbar psi pa kpa hpa ohm kohm mohm ohms l bit bits bool rad rads/s rad/s
        degrees degree lux counts count times ppm kg/h g/s v/s a/s pct/s flag enum status mode mux
        """
    )
)
"""Units of quantities that are not used here; an unknown unit excludes nothing."""
_CELSIUS: Final = re.compile(r"(unit)?(deg|degre|degrees?|grad|gradi|graus)?(cel[sc]i?u?s?|c)(deg|degrees?|grad)?|oc")
_SPELT: Final = re.compile(r"[\s_.*²]|deg(?=[ckf]$)|^unit[:_]?")


def unit_of(text: str) -> Unit | None:
    """Find the quantity of a printed unit; None if unknown, the family `other` for quantities that are not used.

    Examples
    --------
    >>> unit_of("current:A").family, unit_of("deg C").family, unit_of("K").offset
    ('current', 'temperature', -273.15)
    >>> unit_of("rpm").family, unit_of("\ufffdC").family, unit_of("Celcius").family, unit_of("0.25C/bit?")
    ('other', 'temperature', 'temperature', None)
    """
    name = text.rpartition(":")[2].strip().lower().replace("â", "").replace("\u00b3", "3").replace("^", "")
    if not name or name in ("-", "1", "none", "n/a", "unitless"):
        return None
    plain = re.sub(r"[^a-z0-9%/]", "", name)  # a degree sign in a wrong encoding is dropped
    for spelt in (name, _SPELT.sub("", name), name.replace("deg", "").strip(), plain, plain.replace("deg", "")):
        if spelt in UNITS:
            return UNITS[spelt]
    if _CELSIUS.fullmatch(plain):
        return UNITS["celsius"]
    return Unit("other", 1.0, 0.0) if plain in OTHER_UNITS else None


_KNOWN: Final = frozenset(
    w
    for group in (CURRENT, VOLTAGE, TEMPERATURE, CHARGE, DISCHARGE, CHARGING, FLOW, PACK, CELL, SENSED, OTHER_THINGS,
                  NOT_MEASURED, STATISTIC, COOLANT, OUTWARD, AMBIENT, LEVEL, WHOLE_WORDS)
    for w in group
)  # fmt: skip
_SHORTEST: Final = 3
"""Length of the shortest word that is searched inside a compound, except those of _SHORT."""
_SHORT: Final = frozenset(("hv", "lv", "dc", "ac"))
_SYMBOLS: Final = "tuvi"
"""Letters that stand for a quantity in front of the word for its object: Tmot, Ubus."""
_SYLLABLES: Final = 3
"""Syllables of the longest Pinyin word in the lists."""


@lru_cache(maxsize=65536)
def words(text: str) -> tuple[str, ...]:
    """Cut a name into its words; compounds of known words are cut too.

    Examples
    --------
    >>> words("BMU_stateBusHV"), words("LB_Total_Voltage"), words("TempChannel01")
    (('bmu', 'state', 'bus', 'hv'), ('lb', 'total', 'voltage'), ('temp', 'channel', '01'))
    >>> words("BMSmaxPackTemp"), words("Zelltemp_3"), words("Tmot"), words("ZongDianLiu")
    (('bms', 'max', 'pack', 'temp'), ('zell', 'temp', '3'), ('t', 'mot'), ('zong', 'dianliu'))
    """
    found: list[str] = []
    for name in re.findall(r"[A-Za-z0-9]+", text):
        for w in _joined(_moved(_PARTS.findall(name))):
            run_on = _RUN_ON.fullmatch(w)
            found += [run_on[1].lower(), run_on[2].lower()] if run_on else _compound(w.lower())
    return tuple(found)


def _moved(parts: list[str]) -> list[str]:
    """Move a capital letter to the abbreviation before it if this makes the word after it a known one: BMSmax."""
    for k in range(1, len(parts)):
        before, w = parts[k - 1], parts[k]
        if before.isupper() and w[0].isupper() and w.lower() not in _KNOWN and w[1:] in _KNOWN:
            parts[k - 1 : k + 1] = before + w[0], w[1:]
    return parts


def _joined(parts: list[str]) -> Iterable[str]:
    """Join syllables that are written as separate words and form a known word: DianLiu."""
    k = 0
    while k < len(parts):
        for end in range(min(k + _SYLLABLES, len(parts)), k, -1):
            whole = "".join(parts[k:end]).lower()
            if end == k + 1 or (whole in _KNOWN and not any(p.lower() in _KNOWN for p in parts[k:end])):
                yield "".join(parts[k:end])
                k = end
                break


def _compound(word: str) -> list[str]:
    """Cut an unknown word into known ones; if this is not possible, return the word itself."""
    if word in _KNOWN or not word.isalpha():
        return [word]
    if word[0] in _SYMBOLS and word[1:] in _KNOWN and len(word) > _SHORTEST:
        return [word[0], word[1:]]
    return _cut(word) or [word]


def _cut(word: str) -> list[str]:
    for end in range(len(word), 1, -1):
        head = word[:end]
        if head in _SHORT or (end >= _SHORTEST and head in _KNOWN):
            if end == len(word):
                return [head]
            if rest := _cut(word[end:]):
                return [head, *rest]
    return []


def named(info: SignalInfo) -> tuple[str, ...]:
    """Words of a signal's own name."""
    return words(info.name)


def around(info: SignalInfo) -> tuple[str, ...]:
    """Words of its message."""
    return words(info.message)


def has(given: tuple[str, ...], *lists: tuple[str, ...]) -> bool:
    """Whether one of the words is in one of the lists."""
    return any(w in group for w in given for group in lists)


def of_liquid(info: SignalInfo) -> bool:
    """Whether the name of signal or message says that the coolant is a liquid."""
    given = (*named(info), *around(info))
    return has(given, tuple(w for w in COOLANT if w not in INWARD)) and not has(named(info), AMBIENT)


def statistic(info: SignalInfo) -> str | None:
    """`max`, `min` or `mean` if the name says that the signal is a statistic of several cells."""
    return next((STATISTIC[w] for w in named(info) if w in STATISTIC), None)


def numbers(text: str) -> tuple[str, tuple[int, ...]]:
    """Split a name into its pattern and the numbers in it.

    Examples
    --------
    >>> numbers("TempChannel01"), numbers("M3_T5")
    (('TempChannel#', (1,)), ('M#_T#', (3, 5)))
    """
    return re.sub(r"\d+", "#", text), tuple(int(n[:9]) for n in re.findall(r"\d+", text))


def lettered(text: str) -> tuple[str, tuple[str, ...]]:
    """Split a name into its pattern and the words in it that are one letter, A to H.

    Examples
    --------
    >>> lettered("StringB_Current"), lettered("T_a"), lettered("BMS_HV")
    (('String@_Current', ('B',)), ('T_@', ('A',)), ('BMS_HV', ()))
    >>> lettered("BMSA_Temp#"), lettered("ACCUB_Temp#")
    (('BMS@_Temp#', ('A',)), ('ACCU@_Temp#', ('B',)))
    """
    found: list[str] = []

    def blank(word: re.Match[str]) -> str:
        if run_on := _RUN_ON.fullmatch(word[0]) or _CAPITALS.fullmatch(word[0]):
            found.append(run_on[2].upper())
            return f"{run_on[1]}@"
        if len(word[0]) > 1 or word[0].upper() not in "ABCDEFGH":
            return word[0]
        found.append(word[0].upper())
        return "@"

    return _PARTS.sub(blank, text), tuple(found)
