"""The gateway's config file as pydantic values: keys, types, ranges and defaults; nothing is read or resolved here."""

import re
from collections.abc import Iterator
from ipaddress import ip_address
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import AfterValidator, Field, create_model, field_validator, model_validator

from bms_gateway.config.toml import Section
from bms_gateway.engine.plan import Statistic
from bms_gateway.frames.j1939 import LAST_ADDRESS
from bms_gateway.frames.vocabulary import CELL, INPUTS, WHOLE, Quantity
from bms_gateway.health.alerts import CORE_MAX_C, AlertSettings
from bms_gateway.identify.cell_prior import SPREAD, CellSettings
from bms_gateway.thermal import Disturbance

NAME = re.compile(r"[A-Za-z0-9_.-]+")
"""Names of strings go into CSV columns, metrics and file names."""
LOOPBACK = ("localhost", "127.0.0.1", "::1")
IFNAMSIZ = 15  # most bytes of a network interface's name in Linux


def _readable(text: str) -> str:
    if any(ord(c) < 0x20 or ord(c) == 0x7F for c in text):
        raise ValueError(f"{text!r}: has a control character in it")
    return text


Text = Annotated[str, Field(min_length=1), AfterValidator(_readable)]
"""Name of a file, an interface or a host: not empty and printable."""


class Source(Section):
    """Where one quantity comes from: `"Message.Signal"`, `{ signal, scale, offset, … }` or `{ constant }`.

    Attributes
    ----------
    signal : str or None
    scale, offset : float
        Quantity = scale · value + offset, in SI (°C for temperatures), after the DBC's own unit was converted.
    constant, constant_C : float or None
        Value of a quantity that the bus does not carry, SI; `constant_C` for temperatures.
    minimum, maximum : float or None
        Valid range of the signal in the DBC's own unit, where the range that the DBC declares is wrong.
    byte_order : {"little_endian", "big_endian"} or None
        Byte order of the signal, where that of the DBC is wrong.
    signed : bool or None
        Whether the bits are a two's complement, where the DBC declares the opposite.
    mask : int or None
        The bits of the raw value that are the measurement, if the DBC includes others: one run of ones, as 0x0FFF.
    max_of, min_of, mean_of : str or None
        For a surface: the signal is the greatest, least or mean surface of these cells, such as "1-96" or "1,3,5-8".
    discharge, charge : Source or None
        For a current that two signals carry, one for each direction, both positive: the two signals.
    """

    signal: str | None = None
    scale: float = 1.0
    offset: float = 0.0
    constant: float | None = None
    constant_C: float | None = None
    minimum: float | None = None
    maximum: float | None = None
    byte_order: Literal["little_endian", "big_endian"] | None = None
    signed: bool | None = None
    mask: int | None = Field(default=None, ge=1, lt=1 << 64)
    max_of: Text | None = None
    min_of: Text | None = None
    mean_of: Text | None = None
    discharge: "Source | None" = None
    charge: "Source | None" = None

    @model_validator(mode="before")
    @classmethod
    def _name_alone(cls, given: Any) -> Any:
        return {"signal": given} if isinstance(given, str) else given

    @model_validator(mode="after")
    def _one_kind(self) -> "Source":
        given = [x for x in (self.signal, self.constant, self.constant_C) if x is not None]
        if self.directions:
            return self._two_signals()
        if len(given) != 1:
            raise ValueError('needs exactly one of signal = "Message.Signal", constant_C (temperatures) or constant')
        if self.signal is None and (self.scale != 1.0 or self.offset != 0.0):
            raise ValueError("a constant has neither scale nor offset")
        if self.signal is None and self.overrides:
            raise ValueError("minimum, maximum, byte_order, signed and mask belong to a signal, not to a constant")
        if self.minimum is not None and self.maximum is not None and self.minimum >= self.maximum:
            raise ValueError(f"minimum {self.minimum:g} is not below maximum {self.maximum:g}")
        if len(self.statistics) > (self.signal is not None):
            raise ValueError("one of max_of, min_of and mean_of belongs to a signal")
        if self.scale == 0.0:
            raise ValueError("scale = 0 would make every value the offset; use a constant")
        return self

    def _two_signals(self) -> "Source":
        """Check that a current of two signals has nothing but these."""
        if len(self.directions) != 2:
            raise ValueError(f"{next(iter(self.directions))} alone is half a current: name discharge and charge")
        if self.signal is not None:
            raise ValueError("signal is a current of one signal, discharge and charge are one of two: keep either")
        if self.model_fields_set - {"discharge", "charge"}:
            other = ", ".join(sorted(self.model_fields_set - {"discharge", "charge"}))
            raise ValueError(f"{other}: belongs to each of discharge and charge, as discharge.{other.split(', ')[0]}")
        for name, half in self.directions.items():
            if half.directions or half.statistics or half.signal is None:
                raise ValueError(f'{name} must be one signal, as {name} = "Message.Signal"')
        return self

    @property
    def directions(self) -> dict[str, "Source"]:
        """The signals of both directions of a current, by key; empty where one signal carries it."""
        given = {"discharge": self.discharge, "charge": self.charge}
        return {name: half for name, half in given.items() if half is not None}

    @property
    def statistics(self) -> dict[Statistic, str]:
        """The cells of which the signal is the greatest, least or mean one; at most one entry."""
        given: dict[Statistic, str | None] = {"max": self.max_of, "min": self.min_of, "mean": self.mean_of}
        return {kind: cells for kind, cells in given.items() if cells is not None}

    @property
    def overrides(self) -> bool:
        """Whether the config corrects anything that the DBC says of the signal."""
        return any(x is not None for x in (self.minimum, self.maximum, self.byte_order, self.signed, self.mask))


class SignalsOfString(Section):
    """Common part of `[string.signals]`; the keys are those of `INPUTS`."""

    @field_validator("surface", mode="before", check_fields=False)
    @classmethod
    def _one_reading(cls, given: Any) -> Any:
        """Take `surface = { max_of = …, signal = … }` for the only reading of the string."""
        names = ("max_of", "min_of", "mean_of")
        if isinstance(given, dict) and any(isinstance(given.get(name), str) for name in names):
            return {next(name for name in names if name in given): given}
        return given

    def of(self, quantity: Quantity) -> Source | None:
        """Return the source of an input of the whole string."""
        source: Source | None = getattr(self, quantity)
        return source

    def of_cells(self, quantity: Quantity) -> dict[str, Source]:
        """Return the sources of an input of cells, by cell as written."""
        sources: dict[str, Source] = getattr(self, quantity)
        return sources

    def sources(self) -> Iterator[tuple[str, Source]]:
        """List all with their keys."""
        for quantity in WHOLE:
            if (source := self.of(quantity)) is not None:
                yield from _halves(quantity, source)
        for quantity in CELL:
            for cell, source in self.of_cells(quantity).items():
                yield f"{quantity}.{cell}", source


def _halves(key: str, source: Source) -> Iterator[tuple[str, Source]]:
    """List a source, or the two of a current with a signal for each direction."""
    if not source.directions:
        yield key, source
    for name, half in source.directions.items():
        yield f"{key}.{name}", half


_WHOLE_FIELDS: dict[str, Any] = {q: (Source, ...) if INPUTS[q].needed else (Source | None, None) for q in WHOLE}
_CELL_FIELDS: dict[str, Any] = {q: (dict[str, Source], Field(default_factory=dict)) for q in CELL}
if TYPE_CHECKING:
    Signals = SignalsOfString
else:
    Signals = create_model(
        "Signals",
        __base__=SignalsOfString,
        __module__=__name__,
        __doc__="`[string.signals]`; keys of inputs of cells are cells, from 1.",
        **_WHOLE_FIELDS,
        **_CELL_FIELDS,
    )


Method = Literal["window", "rls", "off"]


class String(Section):
    """`[[string]]`.

    Attributes
    ----------
    identify : {"window", "rls", "off"}, optional
        Method for this string, if it differs from that in `[identify]`.
    """

    name: str = Field(min_length=1, max_length=64)
    model: Text
    identify: Method | None = None
    signals: Signals | None = None

    @field_validator("name")
    @classmethod
    def _plain(cls, name: str) -> str:
        if not NAME.fullmatch(name):
            raise ValueError(f"{name!r}: valid are letters A-Z and a-z, digits, '_', '-' and '.'")
        return name


class Bus(Section):
    """`[bus]`.

    Attributes
    ----------
    receive_buffer : int
        Size of the kernel's receive buffer, bytes. The kernel uses memory only as the buffer fills. 8 MiB hold 2.2 s
        of a full 1 Mbit/s bus.
    source_address : int or None
        Source address of all J1939 messages of `dbc`, if it differs from that in the DBC.
    """

    interface: str = "socketcan"
    channel: Text = "vcan0"
    dbc: list[Text] = Field(default_factory=list)
    transmit: bool = True
    receive_buffer: int = Field(default=8 << 20, ge=4096, le=1 << 30)
    source_address: int | None = Field(default=None, ge=0, le=LAST_ADDRESS)

    @model_validator(mode="after")
    def _name_of_linux(self) -> "Bus":
        if self.interface == "socketcan":
            if len(self.channel.encode()) > IFNAMSIZ:
                raise ValueError(f"channel: {self.channel!r}: a SocketCAN interface has at most {IFNAMSIZ} characters")
            if "/" in self.channel or any(c.isspace() for c in self.channel):
                raise ValueError(
                    f"channel: {self.channel!r}: a SocketCAN interface has no blank and no '/' in its name"
                )
        return self


class Identify(Section):
    """`[identify]`."""

    method: Method = "window"


class Store(Section):
    """`[store]`: without a path systemd's StateDirectory is used, and without that nothing is stored.

    Attributes
    ----------
    recent_MB : float
        Most disk space of the recent signals, 10⁶ bytes; 0 keeps none.
    """

    path: Text | None = None
    recent_MB: float = Field(default=64.0, ge=0.0, le=100_000.0)


_UNKNOWN = Disturbance()


class Observer(Section):
    """`[observer]`: uncertainty of the model while it runs, as `thermal.Disturbance`."""

    heat_common_W: float = Field(default=_UNKNOWN.heat_common, ge=0.0, le=1e3)
    heat_cell_W: float = Field(default=_UNKNOWN.heat_cell, ge=0.0, le=1e3)
    inlet_K: float = Field(default=_UNKNOWN.inlet, gt=0.0, le=50.0)
    heat_unknown_W: float = Field(default=_UNKNOWN.heat_unknown, gt=0.0, le=1e4)
    inlet_unknown_K: float = Field(default=_UNKNOWN.inlet_unknown, gt=0.0, le=100.0)
    correlation_s: float = Field(default=_UNKNOWN.correlation, ge=1.0, le=86_400.0)
    sensor_K: float = Field(default=_UNKNOWN.sensor, gt=0.0, le=50.0)

    @property
    def disturbance(self) -> Disturbance:
        """Return these settings for the observers."""
        return Disturbance(
            heat_common=self.heat_common_W,
            heat_cell=self.heat_cell_W,
            heat_unknown=self.heat_unknown_W,
            inlet=self.inlet_K,
            inlet_unknown=self.inlet_unknown_K,
            correlation=self.correlation_s,
            sensor=self.sensor_K,
        )


_CELLS = CellSettings()


class Cells(Section):
    """`[cells]`: identification of single cells by their voltages, as `identify.cell_prior.CellSettings`."""

    joint_rel_sd: float = Field(default=_CELLS.joint_sd, ge=1e-3, le=0.5)
    voltage_skew_s: float = Field(default=_CELLS.skew_s, ge=0.0, le=10.0)
    ratio_rel_sd: float = Field(default=_CELLS.ratio_sd, ge=1e-3, le=1.0)
    surface_offset_K: float = Field(default=_CELLS.offset_sd, ge=1e-3, le=10.0)
    R_e_rel_sd: float = Field(default=SPREAD["R_e"], ge=1e-3, le=0.5)
    R_u_rel_sd: float = Field(default=SPREAD["R_u"], ge=1e-3, le=0.5)
    R_c_rel_sd: float = Field(default=SPREAD["R_c"], ge=1e-3, le=0.5)
    C_c_rel_sd: float = Field(default=SPREAD["C_c"], ge=1e-3, le=0.5)

    @property
    def settings(self) -> CellSettings:
        """Return these settings for the identification."""
        spread = {"R_e": self.R_e_rel_sd, "R_u": self.R_u_rel_sd, "R_c": self.R_c_rel_sd, "C_c": self.C_c_rel_sd}
        return CellSettings(
            spread=spread,
            offset_sd=self.surface_offset_K,
            ratio_sd=self.ratio_rel_sd,
            joint_sd=self.joint_rel_sd,
            skew_s=self.voltage_skew_s,
        )


class EngineSection(Section):
    """`[engine]`."""

    silent_after_s: float = Field(default=60.0, ge=2.0, le=86_400.0)


class Metrics(Section):
    """`[metrics]`: address for Prometheus; loopback unless another address is named, `"off"` for none."""

    listen: str = "127.0.0.1:9105"

    @field_validator("listen")
    @classmethod
    def _address(cls, text: str) -> str:
        if text != "off":
            host, _, port = text.rpartition(":")
            try:
                ip_address(host.removeprefix("[").removesuffix("]"))
                sound = port.isascii() and port.isdigit() and 1 <= int(port) <= 65_535
            except ValueError:
                sound = False
            if not sound:
                raise ValueError(f'{text!r}: expected a numeric address and a port, as "127.0.0.1:9105", or "off"')
        return text

    @property
    def address(self) -> tuple[str, int] | None:
        """Host and port; None when off."""
        if self.listen == "off":
            return None
        host, _, port = self.listen.rpartition(":")
        return host.removeprefix("[").removesuffix("]"), int(port)


class Alerting(Section):
    """`[alerts]`: when a condition becomes an alert, and the limit of the hottest point.

    Attributes
    ----------
    grace_s : float
        Time after a start, and after each pause of the bus, in which no alert is raised.
    hold_s, clear_s : float
        How long a condition must last before its alert is raised, and be absent before the alert is cleared.
    core_max_C : float
        Temperature of a cell's hottest point (not of the mean of its roll) at which an alarm is raised.
    surface_max_C : float or None
        The same limit for a measured surface; `core_max_C` if it is left out.
    """

    grace_s: float = Field(default=10.0, ge=1.0, le=600.0)
    hold_s: float = Field(default=3.0, ge=0.0, le=600.0)
    clear_s: float = Field(default=10.0, ge=0.0, le=3600.0)
    core_max_C: float = Field(default=CORE_MAX_C, gt=-40.0, le=200.0)
    surface_max_C: float | None = Field(default=None, gt=-40.0, le=200.0)

    @model_validator(mode="after")
    def _a_surface_can_reach_its_limit(self) -> "Alerting":
        highest = INPUTS["surface"].plausible[1]
        if self.settings.surface_limit_C >= highest:
            how = "it is that of core_max_C: set it below, as" if self.surface_max_C is None else "set it below, as"
            raise ValueError(
                f"surface_max_C is {self.settings.surface_limit_C:g}, and no surface of {highest:g} °C or more is "
                f"believed, so its alarm would never come; {how} surface_max_C = {highest - 10.0:g}"
            )
        return self

    @property
    def settings(self) -> AlertSettings:
        """Return these settings for the engine."""
        return AlertSettings(self.grace_s, self.hold_s, self.clear_s, self.core_max_C, self.surface_max_C)


TOPIC = re.compile(r"[^\x00-\x20+#$/][^\x00-\x20+#]*")
"""Of MQTT: no wildcards, no blanks, and not below the broker's own `$SYS`."""


class Mqtt(Section):
    """`[mqtt]`: a broker that gets status, alerts and estimates. Without the table there is no MQTT.

    Attributes
    ----------
    topic : str
        Beginning of every topic; each gateway of a broker needs its own.
    password_file, ca_file, cert_file, key_file : str, optional
        Paths relative to the config. Only the owner may be able to read the password and the key.
    interval_s : float
        Time between two summaries of the estimates.
    spool : int
        How many messages of each kind wait in memory while the broker cannot be reached.
    """

    host: Text = Field(max_length=255)
    port: int | None = Field(default=None, ge=1, le=65_535)
    topic: str = Field(default="bms-gateway", max_length=200)
    username: Text | None = None
    password_file: Text | None = None
    tls: bool = False
    ca_file: Text | None = None
    cert_file: Text | None = None
    key_file: Text | None = None
    interval_s: float = Field(default=10.0, ge=1.0, le=86_400.0)
    spool: int = Field(default=1000, ge=10, le=100_000)

    @field_validator("host")
    @classmethod
    def _resolvable(cls, host: str) -> str:
        try:
            host.encode("idna")
        except UnicodeError:
            raise ValueError(f"{host!r}: no name of a computer: a part between dots is empty or too long") from None
        return host

    @field_validator("topic")
    @classmethod
    def _plain_topic(cls, topic: str) -> str:
        if not TOPIC.fullmatch(topic) or topic.endswith("/"):
            raise ValueError(f"{topic!r}: no '+', '#' or blank, no '/' at the ends, no '$' in front")
        return topic

    @model_validator(mode="after")
    def _goes_together(self) -> "Mqtt":
        if self.password_file is not None and self.username is None:
            raise ValueError("password_file needs username")
        if (self.cert_file is None) != (self.key_file is None):
            raise ValueError("cert_file and key_file go together")
        if not self.tls and (self.ca_file or self.cert_file):
            raise ValueError("ca_file and cert_file need tls = true")
        if self.password_file is not None and not self.tls and self.host not in LOOPBACK:
            raise ValueError("password_file needs tls = true: the password would cross the network readable")
        return self


class GatewayConfig(Section):
    """The whole file."""

    bus: Bus = Bus()
    string: list[String] = Field(min_length=1)
    identify: Identify = Identify()
    store: Store = Store()
    observer: Observer = Observer()
    cells: Cells = Cells()
    engine: EngineSection = EngineSection()
    metrics: Metrics = Metrics()
    alerts: Alerting = Alerting()
    mqtt: Mqtt | None = None

    @model_validator(mode="before")
    @classmethod
    def _a_list_of_tables(cls, given: Any) -> Any:
        strings = given.get("string") if isinstance(given, dict) else None
        if isinstance(strings, dict):
            raise ValueError("string: write [[string]], in double brackets: there may be several")  # noqa: TRY004 — what pydantic takes
        if strings == []:
            raise ValueError("string: needs at least one [[string]]")
        return given

    @model_validator(mode="after")
    def _names_differ(self) -> "GatewayConfig":
        names = [s.name for s in self.string]
        for name in names:
            if names.count(name) > 1:
                raise ValueError(f"string: two strings are called {name!r}")
        return self
