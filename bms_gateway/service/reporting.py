"""Sets up what runs beside the gateway: alerts always, metrics and MQTT if the config has them.

What the config does not have is not imported.
"""

from collections.abc import Callable, Iterator
from importlib.util import find_spec
from typing import TYPE_CHECKING

from bms_gateway.config.load import LoadedConfig, mqtt_files
from bms_gateway.errors import ConfigError, MissingExtraError
from bms_gateway.service.live import Gateway
from bms_gateway.service.summary import estimates, status
from bms_gateway.service.watch import Watch

if TYPE_CHECKING:
    from bms_gateway.config.schema import GatewayConfig
    from bms_gateway.engine import Engine
    from bms_gateway.service.exposition import Family


def accompany(gateway: Gateway, loaded: LoadedConfig, engine: "Callable[[], Engine]") -> Watch:
    """Add the parts in its config to a gateway before it runs.

    Parameters
    ----------
    gateway : Gateway
    loaded : LoadedConfig
    engine : callable
        Returns the present engine.

    Returns
    -------
    Watch
    """
    config = loaded.config
    watch = Watch(gateway, engine, channel=config.bus.channel, settings=loaded.plan.alerts)
    gateway.beside["alerts"] = watch.run
    gateway.summary = lambda: watch.alerts.line
    watch.listeners.append(lambda _: gateway.tell_status())
    more: list[Callable[[], Iterator[Family]]] = []
    if (address := config.metrics.address) is not None:
        from bms_gateway.service.exposition import CONTENT_TYPE
        from bms_gateway.service.http import MetricsServer
        from bms_gateway.service.metrics import Page

        server = MetricsServer(*address, Page(gateway, engine, watch, more), CONTENT_TYPE)
        gateway.beside["metrics"] = server.run
    if config.mqtt is not None:
        if find_spec("aiomqtt") is None:
            raise MissingExtraError(f"{loaded.path}: [mqtt]", "mqtt")
        from bms_gateway.service.mqtt import Publisher

        publisher = Publisher(
            config.mqtt,
            mqtt_files(loaded.path, config),
            status=lambda: status(gateway, watch, engine()),
            estimates=lambda: estimates(gateway, watch, engine()),
        )
        watch.listeners.append(publisher.on_change)
        gateway.beside["mqtt"] = publisher.run
        more.append(publisher.broker.families)
    return watch


def same_beside(running: "GatewayConfig", wanted: "GatewayConfig", where: object) -> None:
    """Check that a new config has the same parts beside the gateway as the running one.

    Parameters
    ----------
    running, wanted : GatewayConfig
    where : object
        Path of the file, for the error line.

    Raises
    ------
    ConfigError
        The change needs a restart.
    """
    for section in ("metrics", "alerts", "mqtt", "store"):
        if getattr(wanted, section) != getattr(running, section):
            raise ConfigError(f"{where}: [{section}] has changed: restart the service")
    for key in ("interface", "channel", "receive_buffer"):  # of the port that is open
        if getattr(wanted.bus, key) != getattr(running.bus, key):
            raise ConfigError(f"{where}: bus.{key} has changed: restart the service")
