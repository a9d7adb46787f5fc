"""From the user's TOML files to the engine's plan."""

from bms_gateway.config.dbc_files import own_dbc_text, shipped
from bms_gateway.config.load import LoadedConfig, load_config
from bms_gateway.config.model_file import format_model, parse_model, read_model, write_model
from bms_gateway.config.schema import GatewayConfig

__all__ = [
    "GatewayConfig",
    "LoadedConfig",
    "format_model",
    "load_config",
    "own_dbc_text",
    "parse_model",
    "read_model",
    "shipped",
    "write_model",
]
