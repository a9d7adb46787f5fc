"""From a gateway's config file to the engine's plan: models read, signals found in their DBC, units brought to SI."""

import os
import stat
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from math import inf
from pathlib import Path, PureWindowsPath
from typing import TYPE_CHECKING, Final

from bms_gateway.config.credential import SECRET_KEYS, check_secret, credential
from bms_gateway.config.dbc_files import dbc_text, own_dbc_text, read_dbc
from bms_gateway.config.model_file import read_model
from bms_gateway.config.overrides import put_right
from bms_gateway.config.read_bounds import bounded
from bms_gateway.config.schema import GatewayConfig, Signals, Source, String
from bms_gateway.config.text_file import nearest_file
from bms_gateway.config.toml import MOST_SHOWN, read_toml, validate
from bms_gateway.config.units import signal_conversion
from bms_gateway.engine.plan import Channel, Plan, StringPlan
from bms_gateway.errors import ConfigError, clipped, counted, did_you_mean, whole_number
from bms_gateway.frames.batch import EXTENDED
from bms_gateway.frames.database import Database, Read
from bms_gateway.frames.j1939 import sent_from
from bms_gateway.frames.own_dbc import MAX_CELLS, MAX_STRINGS, OWN_DBC, own_signal
from bms_gateway.frames.signal_info import MessageInfo, SignalInfo
from bms_gateway.frames.vocabulary import CELL, INPUTS, WHOLE, Quantity
from bms_gateway.thermal import StringModel

if TYPE_CHECKING:
    from bms_gateway.engine import Engine

MOST_LISTED: Final = 1000
LEAST_SHARE: Final = 1e-6
"""Least range of a signal, as a share of the plausible range: smaller signals always say the same."""
MOST_OFF: Final = 1e12
"""Limit for floating-point numbers: greatest factor over the plausible range, and its inverse for the least."""
ENGINE_S: Final = 15.0
ENGINE_MIB: Final = 160
"""MiB: a string of 300 cells takes 150; the unit has 256 for all."""


@dataclass(frozen=True, slots=True)
class LoadedConfig:
    """A config file and all files that it names.

    Attributes
    ----------
    path : Path
    config : GatewayConfig
        As written, with defaults.
    plan : Plan
    database : Database
        Of the plan's DBC files and ours, because parsing takes longer than the rest of a start.
    store : Path or None
        Directory of the stored state; None: nothing is stored.
    files : tuple of Path
        All files that were read: the config, its DBC and model files. No result may be written to one of them.
    """

    path: Path
    config: GatewayConfig
    plan: Plan
    database: Database
    store: Path | None
    files: tuple[Path, ...]

    def engine(self) -> "Engine":
        """Make an engine, as the service does.

        Raises
        ------
        ConfigError
            It takes more time or memory than a service has: strings with too many cells.
        """
        from bms_gateway.engine import Engine

        with bounded(str(self.path), seconds=ENGINE_S, mib=ENGINE_MIB, doing="making the estimators of its strings"):
            return Engine(self.plan, self.database)


def load_config(path: Path, *, uploaded: bool = False) -> LoadedConfig:
    """Read a gateway's config with its DBC and model files.

    Parameters
    ----------
    path : Path
        Files that it names are relative to its directory.
    uploaded : bool
        Whether the config comes from somebody who may not choose which files this computer reads. Of each path in the
        config, only the file name counts then, and the file must lie beside the config.

    Returns
    -------
    LoadedConfig
        With every signal found: the engine can use its plan directly.

    Raises
    ------
    ConfigError
        One line: file, key, what is wrong, the nearest valid choice.
    """
    with bounded(str(path)):
        return _load(path, uploaded)


def _reader(where: str, config: GatewayConfig, databases: Mapping[str, str]) -> Read:
    """Read DBC files, with the source address of J1939 messages that the config states.

    If no file marks messages as J1939, all messages with 29 bits count as such: the address has no other meaning.
    """
    address = config.bus.source_address
    if address is None:
        return read_dbc
    found = {name: read_dbc(name, text) for name, text in databases.items()}
    marked = [name for name, messages in found.items() if any(m.any_sender for m in messages)]
    marked = marked or [name for name, messages in found.items() if any(m.can_id & EXTENDED for m in messages)]
    if not marked:
        raise ConfigError(
            f"{where}: bus.source_address: no file in bus.dbc has messages of J1939, whose identifiers have 29 bits"
        )
    found |= {name: sent_from(found[name], address) for name in marked}

    def read(name: str, text: str) -> list[MessageInfo]:
        return found[name] if name in found else read_dbc(name, text)

    return read


def _load(path: Path, uploaded: bool) -> LoadedConfig:
    where = str(path)
    data = read_toml(path, "gateway config")
    if "parameters" in data and "string" not in data:
        raise ConfigError(f"{where}: is the model file of a string; a gateway config is needed, which names such files")
    config = validate(GatewayConfig, data, where)
    if uploaded:
        config = _beside(config)
    databases = {}
    for i, name in enumerate(config.bus.dbc, 1):
        file = _file(path, name, f"bus.dbc[{i}]")
        databases[str(file)] = dbc_text(file)
    database = Database.load({**databases, OWN_DBC: own_dbc_text()}, _reader(where, config, databases))
    _dbc_for_signals(where, config, database)
    database = put_right(where, config, database)
    _known_interface(where, config.bus.interface)
    _limits(where, config)
    strings = tuple(_string(path, config, i, s, database) for i, s in enumerate(config.string, 1))
    plan = Plan(
        strings,
        transmit=config.bus.transmit,
        silent_after_ns=round(config.engine.silent_after_s * 1e9),
        disturbance=config.observer.disturbance,
        cells=config.cells.settings,
        alerts=config.alerts.settings,
    )
    models = [path.parent / s.model for s in config.string]
    files = tuple(dict.fromkeys([path, *map(Path, databases), *models, *mqtt_files(path, config).values()]))
    return LoadedConfig(path, config, plan, database, _store(path, config), files)


def _dbc_for_signals(where: str, config: GatewayConfig, database: Database) -> None:
    """Refuse signals of a vehicle's DBC if the config names none."""
    for number, string in enumerate(config.string if not config.bus.dbc else [], 1):
        for key, source in string.signals.sources() if string.signals is not None else ():
            message, dot, _ = (source.signal or "").partition(".")
            if dot and message not in database.messages:
                raise ConfigError(
                    f"{where}: bus.dbc names no file, and string[{number}].signals.{key} needs the DBC with message "
                    f"'{clipped(message, MOST_SHOWN)}': dbc = [\"vehicle.dbc\"]"
                )


def _beside(config: GatewayConfig) -> GatewayConfig:
    """Keep only the last part of every path; leave out the tables that only the service needs: they name secrets."""

    def plain(name: str) -> str:
        return PureWindowsPath(name).name  # takes both kinds of slash

    strings = [s.model_copy(update={"model": plain(s.model)}) for s in config.string]
    bus = config.bus.model_copy(update={"dbc": [plain(name) for name in config.bus.dbc]})
    return config.model_copy(update={"bus": bus, "string": strings, "mqtt": None})


def _string(path: Path, config: GatewayConfig, number: int, string: String, database: Database) -> StringPlan:
    key = f"string[{number}]"
    model = read_model(_file(path, string.model, f"{key}.model"))
    if model.cells > MAX_CELLS and (config.bus.transmit or string.signals is None):
        raise ConfigError(
            f"{path}: {key}.model: {counted(model.cells, 'cell')}: our DBC has {MAX_CELLS} per string; "
            "split the string, or give it [string.signals] and set bus.transmit = false"
        )
    if string.signals is None:
        channels = tuple(_own_channels(number, model, database))
    else:
        channels = tuple(_Wiring(f"{path}: {key}.signals", model, database).channels(string.signals))
    method = string.identify or config.identify.method
    several = {k for c in channels for k in c.among}
    if several:
        # the reading may belong to any of them, so it cannot identify the parameters of one cell
        model = replace(model, sensors=tuple(sorted({*model.sensors, *several})))
        method = string.identify or "off"
    return StringPlan(string.name, number, model, channels, method)


def _own_channels(number: int, model: StringModel, database: Database) -> Iterator[Channel]:
    """Yield the channels of our own DBC for the string of this number, as far as its model can use them."""
    wanted: list[tuple[Quantity, int | None]] = [
        (q, None) for q in WHOLE if q != "coolant_flow" or model.flow is not None
    ]
    for q in CELL:
        wanted += [(q, k) for k in (model.sensors if q == "surface" else range(1, model.cells + 1))]
    for quantity, cell in wanted:
        if INPUTS[quantity].own is None:
            continue
        signal = own_signal(number, quantity, cell)
        scale, offset = signal_conversion(quantity, database.resolve(signal).unit)
        yield Channel(quantity, cell, signal, None, scale, offset)


@dataclass(frozen=True, slots=True)
class _Wiring:
    """`[string.signals]` of one string; `where` leads its error lines."""

    where: str
    model: StringModel
    database: Database

    def channels(self, signals: Signals) -> Iterator[Channel]:
        if signals.of("coolant_flow") is not None and self.model.flow is None:
            raise ConfigError(
                f"{self.where}.coolant_flow: the model file needs parameters.coolant_flow, the nominal flow"
            )
        for quantity in WHOLE:
            if (source := signals.of(quantity)) is not None:
                yield self._channel(quantity, None, source)
        surfaces = signals.of_cells("surface")
        several = {key: s for key, s in surfaces.items() if s.statistics}
        surface = self._cells("surface", {k: s for k, s in surfaces.items() if k not in several})
        statistics = [self._statistic(key, source) for key, source in several.items()]
        kinds = [c.statistic for c in statistics]
        if len(set(kinds)) < len(kinds):
            raise ConfigError(f"{self.where}.surface: one max_of, one min_of and one mean_of at most")
        self._sensors(set(surface), {k for c in statistics for k in c.among})
        yield from statistics
        for cell in sorted(surface):
            yield self._channel("surface", cell, surface[cell])
        for quantity in CELL:
            if quantity != "surface":
                sources = self._cells(quantity, signals.of_cells(quantity))
                for cell in sorted(sources):
                    yield self._channel(quantity, cell, sources[cell])

    def _cells(self, quantity: str, sources: dict[str, Source]) -> dict[int, Source]:
        """Order sources by cell; refuse a signal that is named for two cells."""
        found: dict[int, Source] = {}
        users: dict[str | None, int] = {}
        for text, source in sources.items():
            key = f"{self.where}.{quantity}.{text}"
            cell = whole_number(text)
            if cell is None or not 1 <= cell <= self.model.cells:
                raise ConfigError(f"{clipped(key, MOST_SHOWN)}: no such cell; valid: 1 to {self.model.cells}")
            if cell in found:
                raise ConfigError(f"{key}: cell {cell} is named twice")
            other = users.setdefault(source.signal, cell)
            if other != cell and source.signal is not None:
                raise ConfigError(f"{key}: signal '{source.signal}' is cell {other}'s already")
            found[cell] = source
        return found

    def _statistic(self, key: str, source: Source) -> Channel:
        """Make the channel of a reading that is the greatest, least or mean one of several cells."""
        kind, text = next(iter(source.statistics.items()))
        where = f"{self.where}.surface.{key}.{kind}_of"
        try:
            among = cell_list(text)
        except ValueError:
            raise ConfigError(f'{where}: {text!r}: expected cells as "1-96" or "1,3,5-8"') from None
        if not among or among[0] < 1 or among[-1] > self.model.cells:
            raise ConfigError(f"{where}: {text!r}: no such cells; valid: 1 to {self.model.cells}")
        return replace(self._channel("surface", None, source), statistic=kind, among=among)

    def _sensors(self, given: set[int], covered: set[int]) -> None:
        expected = set(self.model.sensors) - (covered - given)
        if given - expected:
            cells = ", ".join(map(str, sorted(given - expected)))
            raise ConfigError(
                f"{self.where}.surface: cell {cells}: not among the model's sensors {sorted(expected)}; "
                "add it there or leave it out here"
            )
        if expected - given:
            cells = ", ".join(map(str, sorted(expected - given)))
            raise ConfigError(f"{self.where}.surface: no signal for cell {cells}, a sensor of the model")

    def _channel(self, quantity: Quantity, cell: int | None, source: Source) -> Channel:
        key = f"{self.where}.{quantity}" + (f".{cell}" if cell is not None else "")
        if source.directions:
            return self._two_signals(key, quantity, source)
        return self._one_signal(key, quantity, cell, source)

    def _two_signals(self, key: str, quantity: Quantity, source: Source) -> Channel:
        """Make the channel of a current that has one signal for each direction."""
        if quantity != "current":
            raise ConfigError(f'{key}: discharge and charge belong to current; here: signal = "Message.Signal"')
        out, into = (self._one_signal(f"{key}.{x}", quantity, None, half) for x, half in source.directions.items())
        if out.signal == into.signal:
            raise ConfigError(f"{key}: '{out.signal}' is named for both directions; one signal alone: current = ...")
        return replace(out, way=1, charge=replace(into, scale=-into.scale, offset=0.0 - into.offset, way=-1))

    def _one_signal(self, key: str, quantity: Quantity, cell: int | None, source: Source) -> Channel:
        if source.signal is None:
            return Channel(quantity, cell, None, _constant(key, quantity, source))
        try:
            info = self.database.resolve(source.signal)
        except ConfigError as e:
            raise ConfigError(f"{key}: {e}") from None
        try:
            scale, offset = signal_conversion(quantity, info.unit)
        except ConfigError as e:
            raise ConfigError(f"{key}: '{source.signal}': {e}") from None
        if scale != 1.0 and abs(source.scale) == scale:
            raise ConfigError(
                f"{key}: the DBC gives '{source.signal}' in {info.unit}, which is converted without a scale; "
                f"leave scale = {source.scale:g} out"
            )
        channel = Channel(
            quantity, cell, source.signal, None, source.scale * scale, source.scale * offset + source.offset
        )
        _refuse_senseless(key, source, channel, info)
        return channel


def _refuse_senseless(key: str, source: Source, c: Channel, info: SignalInfo) -> None:
    """Refuse a signal whose bits have no plausible value, or whose step contains the whole plausible range.

    Raises
    ------
    ConfigError
        The message names the scale at fault, and the valid scales.
    """
    low, high = INPUTS[c.quantity].plausible
    step = abs(c.scale * info.scale)
    if info.is_float:
        ends, least, most = (low, high), (high - low) / MOST_OFF, MOST_OFF * (high - low)
        fits = least <= step <= most
    else:
        ends = (
            min(both := [c.scale * (raw * info.scale + info.offset) + c.offset for raw in info.raw_limits]),
            max(both),
        )
        least, most = LEAST_SHARE * (high - low) / 2**info.place.size, high - low
        fits = step <= most and ends[0] <= high and ends[1] >= low and ends[1] - ends[0] >= LEAST_SHARE * (high - low)
    if fits:
        return
    unit = INPUTS[c.quantity].unit or "shares of 1"
    stated, rest = (source.scale, step / abs(source.scale)) if source.scale != 1.0 else (info.scale, abs(c.scale))
    whose = "" if source.scale != 1.0 else f" of {info.database}"
    valid = (
        f"; valid: {least / rest:.2g} to {most / rest:.2g}" if 0.0 < rest < inf and not least <= step <= most else ""
    )
    raise ConfigError(
        f"{key}: '{source.signal}': with the scale {stated:g}{whose} its bits say {ends[0]:.4g} to {ends[1]:.4g} "
        f"{unit} in steps of {step:.3g}, and the gateway believes {low:g} to {high:g}: correct scale or offset{valid}"
    )


def cell_list(text: str) -> tuple[int, ...]:
    """Parse a list of cells.

    Raises
    ------
    ValueError
        It is not a list of cells.

    Examples
    --------
    >>> cell_list("1,3,5-8")
    (1, 3, 5, 6, 7, 8)
    """
    found: set[int] = set()
    for part in text.split(","):
        first, dash, last = part.partition("-")
        ends = int(first), int(last) if dash else int(first)
        if not 0 < ends[0] <= ends[1] <= MOST_LISTED:
            raise ValueError(part)
        found.update(range(ends[0], ends[1] + 1))
    return tuple(sorted(found))


def _constant(key: str, quantity: Quantity, source: Source) -> float:
    allowed = INPUTS[quantity].constant
    if allowed is None:
        raise ConfigError(f"{key}: must be a signal of the bus; a constant tells nothing")
    value = source.constant if source.constant_C is None else source.constant_C
    assert value is not None  # noqa: S101 — the schema has one of the two where there is no signal
    if source.constant_C is not None and INPUTS[quantity].kind != "temperature":
        raise ConfigError(f"{key}: constant_C is for temperatures; use constant")
    low, high = allowed
    if not low <= value <= high:
        raise ConfigError(f"{key}: {value:g} is not plausible; valid: {low:g} to {high:g}")
    return value


def _known_interface(where: str, name: str) -> None:
    if name == "socketcan":
        return
    from can.interfaces import VALID_INTERFACES  # the others are python-can's, installed plugins too

    if name not in VALID_INTERFACES:
        near = did_you_mean(name, sorted(VALID_INTERFACES))
        raise ConfigError(f"{where}: bus.interface: no CAN interface is called '{name}'{near}")


def _limits(where: str, config: GatewayConfig) -> None:
    """Check the number of strings: our DBC limits it, unless the config neither sends nor receives by our DBC."""
    if len(config.string) <= MAX_STRINGS:
        return
    first = next((i for i, s in enumerate(config.string, 1) if s.signals is None and i > MAX_STRINGS), None)
    if first is not None:
        raise ConfigError(f"{where}: string[{first}]: our DBC has {MAX_STRINGS} strings; give it [string.signals]")
    if config.bus.transmit:
        raise ConfigError(
            f"{where}: {len(config.string)} strings: our DBC has {MAX_STRINGS}; "
            "leave some out or set bus.transmit = false"
        )


def _file(config: Path, name: str, key: str) -> Path:
    """Find a file that the config names, relative to it."""
    file = config.parent / name
    try:
        mode = file.stat().st_mode
    except (FileNotFoundError, NotADirectoryError):
        raise ConfigError(f"{config}: {key}: no file {str(file)!r}{nearest_file(file)}") from None
    except OSError as e:  # a folder that may not be entered, a name that is too long
        raise ConfigError(
            f"{config}: {key}: {clipped(repr(str(file)), MOST_SHOWN)} cannot be read: {e.strerror}"
        ) from None
    if stat.S_ISDIR(mode):
        raise ConfigError(f"{config}: {key}: {str(file)!r} is a directory; expected a file")
    if not stat.S_ISREG(mode):
        raise ConfigError(f"{config}: {key}: {str(file)!r} is no plain file")
    return file


def mqtt_files(path: Path, config: GatewayConfig) -> dict[str, Path]:
    """Find the files of `[mqtt]`, by key.

    Raises
    ------
    ConfigError
        One is missing, or holds a secret and is open to others.
    """
    m = config.mqtt
    if m is None:
        return {}
    named = {"password_file": m.password_file, "ca_file": m.ca_file, "cert_file": m.cert_file, "key_file": m.key_file}
    files = {key: credential(_file, path, name, f"mqtt.{key}") for key, name in named.items() if name is not None}
    for key in sorted(SECRET_KEYS & files.keys()):
        check_secret(files[key], f"{path}: mqtt.{key}")
    return files


def _store(path: Path, config: GatewayConfig) -> Path | None:
    if config.store.path is not None:
        return path.parent / config.store.path
    # systemd lists several directories with colons; ours is the first.
    given = os.environ.get("STATE_DIRECTORY", "").split(":")[0]
    return Path(given) if given else None
