"""From a gateway's config file to the engine's plan: models read, signals found in their DBC, units brought to SI."""

import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from bms_gateway.config.credential import SECRET_KEYS, check_secret, credential
from bms_gateway.config.dbc import dbc_text, own_dbc_text, read_dbc
from bms_gateway.config.model_file import read_model
from bms_gateway.config.schema import GatewayConfig, Signals, Source, String
from bms_gateway.config.toml import nearest_file, read_toml, validate
from bms_gateway.config.units import signal_conversion
from bms_gateway.engine.plan import Channel, Plan, Quantity, StringPlan
from bms_gateway.errors import ConfigError, did_you_mean
from bms_gateway.frames.database import Database
from bms_gateway.frames.own import MAX_CELLS, MAX_STRINGS, OWN_DBC, own_signal
from bms_gateway.thermal import StringModel

# Where a number may stand in for a measurement. Current and surfaces are what all estimates come from.
_CONSTANTS: dict[str, tuple[float, float]] = {
    "coolant_inlet": (-60.0, 150.0),
    "coolant_flow": (1e-9, 10.0),
    "soc": (0.0, 1.0),
}


@dataclass(frozen=True, slots=True)
class LoadedConfig:
    """A config file and all that it names.

    Attributes
    ----------
    path : Path
    config : GatewayConfig
        As written, with defaults.
    plan : Plan
    database : Database
        Of the plan's DBC files and ours; parsing them again would take longer than all else here.
    store : Path or None
        Directory of the stored state; None: nothing is stored.
    files : tuple of Path
        All that was read for it: the config, its DBC and model files. No result may be written to one of them.
    """

    path: Path
    config: GatewayConfig
    plan: Plan
    database: Database
    store: Path | None
    files: tuple[Path, ...]


def load_config(path: Path) -> LoadedConfig:
    """Read a gateway's config with its DBC and model files.

    Parameters
    ----------
    path : Path
        Files that it names are relative to its directory.

    Returns
    -------
    LoadedConfig
        With every signal found: the engine takes its plan as it is.

    Raises
    ------
    ConfigError
        One line: file, key, what is wrong, the nearest valid choice.
    """
    where = str(path)
    config = validate(GatewayConfig, read_toml(path), where)
    databases = {}
    for i, name in enumerate(config.bus.dbc, 1):
        file = _file(path, name, f"bus.dbc[{i}]")
        databases[str(file)] = dbc_text(file)
    database = Database.load({**databases, OWN_DBC: own_dbc_text()}, read_dbc)
    _known_interface(where, config.bus.interface)
    _limits(where, config)
    strings = tuple(_string(path, config, i, s, database) for i, s in enumerate(config.string, 1))
    plan = Plan(
        strings,
        transmit=config.bus.transmit,
        silent_after_ns=round(config.engine.silent_after_s * 1e9),
        disturbance=config.observer.disturbance,
        cells=config.cells.settings,
    )
    models = [path.parent / s.model for s in config.string]
    files = tuple(dict.fromkeys([path, *map(Path, databases), *models, *mqtt_files(path, config).values()]))
    return LoadedConfig(path, config, plan, database, _store(path, config), files)


def _string(path: Path, config: GatewayConfig, number: int, string: String, database: Database) -> StringPlan:
    key = f"string[{number}]"
    model = read_model(_file(path, string.model, f"{key}.model"))
    if model.cells > MAX_CELLS and (config.bus.transmit or string.signals is None):
        raise ConfigError(
            f"{path}: {key}.model: {model.cells} cells: our DBC has {MAX_CELLS} per string; "
            "split the string, or give it [string.signals] and set bus.transmit = false"
        )
    if string.signals is None:
        channels = tuple(_own_channels(number, model, database))
    else:
        channels = tuple(_Wiring(f"{path}: {key}.signals", model, database).channels(string.signals))
    return StringPlan(string.name, number, model, channels, string.identify or config.identify.method)


def _own_channels(number: int, model: StringModel, database: Database) -> Iterator[Channel]:
    """Take the messages of our own DBC for the string of this number, as far as its model can use them."""
    cells = range(1, model.cells + 1)
    wanted: list[tuple[Quantity, int | None]] = [("current", None), ("voltage", None), ("coolant_inlet", None)]
    if model.flow is not None:
        wanted.append(("coolant_flow", None))
    wanted += [("soc", None), *(("surface", k) for k in model.sensors), *(("cell_voltage", k) for k in cells)]
    for quantity, cell in wanted:
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
        if signals.coolant_flow is not None and self.model.flow is None:
            raise ConfigError(
                f"{self.where}.coolant_flow: the model file needs parameters.coolant_flow, the nominal flow"
            )
        yield self._channel("current", None, signals.current)
        yield self._channel("coolant_inlet", None, signals.coolant_inlet)
        optional: tuple[tuple[Quantity, Source | None], ...] = (
            ("voltage", signals.voltage),
            ("soc", signals.soc),
            ("coolant_flow", signals.coolant_flow),
        )
        for quantity, source in optional:
            if source is not None:
                yield self._channel(quantity, None, source)
        surface = self._cells("surface", signals.surface)
        self._sensors(set(surface))
        for cell in sorted(surface):
            yield self._channel("surface", cell, surface[cell])
        voltages = self._cells("cell_voltage", signals.cell_voltage)
        for cell in sorted(voltages):
            yield self._channel("cell_voltage", cell, voltages[cell])

    def _cells(self, quantity: str, sources: dict[str, Source]) -> dict[int, Source]:
        """Order sources by cell; a signal that stands for two cells is a slip of the pen."""
        found: dict[int, Source] = {}
        users: dict[str | None, int] = {}
        for text, source in sources.items():
            key = f"{self.where}.{quantity}.{text}"
            if not text.isascii() or not text.isdigit() or not 1 <= int(text) <= self.model.cells:
                raise ConfigError(f"{key}: no such cell; valid: 1 to {self.model.cells}")
            cell = int(text)
            if cell in found:
                raise ConfigError(f"{key}: cell {cell} is named twice")
            other = users.setdefault(source.signal, cell)
            if other != cell and source.signal is not None:
                raise ConfigError(f"{key}: signal '{source.signal}' is cell {other}'s already")
            found[cell] = source
        return found

    def _sensors(self, given: set[int]) -> None:
        expected = set(self.model.sensors)
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
        return Channel(quantity, cell, source.signal, None, source.scale * scale, source.scale * offset + source.offset)


def _constant(key: str, quantity: str, source: Source) -> float:
    if quantity not in _CONSTANTS:
        raise ConfigError(f"{key}: must be a signal of the bus; a constant tells nothing")
    value = source.constant if source.constant_C is None else source.constant_C
    assert value is not None  # noqa: S101 — the schema has one of the two where there is no signal
    if source.constant_C is not None and quantity != "coolant_inlet":
        raise ConfigError(f"{key}: constant_C is for temperatures; use constant")
    low, high = _CONSTANTS[quantity]
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
    """Our DBC has so many strings; without ours to send or to receive any number goes."""
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
    if file.is_dir():
        raise ConfigError(f"{config}: {key}: {str(file)!r} is a directory; expected a file")
    if not file.exists():
        raise ConfigError(f"{config}: {key}: no file {str(file)!r}{nearest_file(file)}")
    if not file.is_file():
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
