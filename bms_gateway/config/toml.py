"""From a TOML file to a checked value: every fault becomes one line that names file, key and nearest choice."""

import re
import tomllib
from pathlib import Path
from types import UnionType
from typing import Any, Literal, TypeVar, Union, get_args, get_origin

from pydantic import BaseModel, ConfigDict, ValidationError

from bms_gateway.config.other_files import HEAD, kind_of_file, other_kind
from bms_gateway.config.read_bounds import bounded
from bms_gateway.config.text_file import decoded, read_bytes
from bms_gateway.errors import ConfigError, clipped, did_you_mean

M = TypeVar("M", bound=BaseModel)
MOST_BYTES = 16 << 20
"""Longest text. A model file of a commissioned string of 200 cells, with a matrix of 800 rows, has 13 MB."""
DEEPEST = 20
MOST_SHOWN = 200


class Section(BaseModel):
    """A table of a user's file: unknown keys, non-finite numbers and numbers in quotes are refused."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, strict=True)


def read_toml(path: Path, what: str) -> dict[str, Any]:
    """Read a TOML file; error lines call what is expected `what`.

    Raises
    ------
    ConfigError
        Missing, unreadable or not TOML; the message names the nearest existing file, or the line.
    """
    return parse_toml(read_text(path, what), str(path), what)


def parse_toml(text: str, where: str, what: str) -> dict[str, Any]:
    """Parse TOML text; error lines call it `where`, and what is expected `what`."""
    with bounded(where):
        try:
            data = tomllib.loads(text)
        except tomllib.TOMLDecodeError as e:
            if (kind := other_kind(text[:HEAD])) is not None:
                raise ConfigError(f"{where}: is {kind}, not a {what}") from None
            raise ConfigError(f"{where}: not valid TOML: {one_line(str(e))}") from None
        except RecursionError:
            raise ConfigError(f"{where}: not valid here: arrays or tables nested over {DEEPEST} deep") from None
        except ValueError as e:  # of Python itself: a number of too many digits, a time that is none
            raise ConfigError(f"{where}: not valid TOML: {_no_value(text, str(e))}") from None
        _refuse_extremes(data, where)
    return data


def read_text(path: Path, what: str = "TOML file") -> str:
    """Read a text file of the user; skip the byte-order mark that Windows writes before UTF-8.

    Parameters
    ----------
    path : Path
    what : str
        What is expected, in error lines about a file of another kind.

    Raises
    ------
    ConfigError
        Missing, unreadable, too long, empty or not UTF-8.
    """
    try:
        text = decoded(read_bytes(path, MOST_BYTES), "utf-8-sig", path, MOST_BYTES)
    except (ConfigError, UnicodeDecodeError) as e:
        if (kind := kind_of_file(path)) is not None:
            raise ConfigError(f"{path}: is {kind}, not a {what}") from None
        if isinstance(e, ConfigError):
            raise
        raise ConfigError(f"{path}: not UTF-8 text (byte {e.start})") from None
    if not text.strip():
        raise ConfigError(f"{path}: is empty")
    return text


def _no_value(text: str, problem: str) -> str:
    found = re.search(r"\d[\d_]{4299,}", text)
    if found is None:
        return one_line(problem)
    return f"a number of {len(found[0])} digits (at line {text.count(chr(10), 0, found.start()) + 1})"


def _refuse_extremes(data: object, where: str) -> None:
    """Refuse deep nesting and integers beyond 64 bits, which no config needs and no line could show."""
    inner: list[tuple[object, tuple[int | str, ...]]] = [(data, ())]
    while inner:
        value, place = inner.pop()
        if isinstance(value, int) and not -(1 << 63) <= value < 1 << 63:
            raise ConfigError(
                f"{where}: {clipped(dotted(place), MOST_SHOWN)}: an integer that does not fit into 64 bits"
            )
        if isinstance(value, dict | list):
            if len(place) > DEEPEST:
                raise ConfigError(f"{where}: {clipped(dotted(place), MOST_SHOWN)}: nested over {DEEPEST} deep")
            items = value.items() if isinstance(value, dict) else enumerate(value)
            inner += ((x, (*place, key)) for key, x in items)


def one_line(text: str) -> str:
    """Fold a message of another library into one line."""
    return re.sub(r"\s+", " ", text).strip()


def validate(schema: type[M], data: object, where: str) -> M:
    """Check parsed data against a schema.

    Parameters
    ----------
    schema : type of BaseModel
    data : object
        Result of the TOML parser.
    where : str
        Name of the file in error lines.

    Raises
    ------
    ConfigError
        One line about the first fault, and how many more there are.
    """
    try:
        return schema.model_validate(data)
    except ValidationError as e:
        # An unknown key is usually the reason for a missing one: it is reported first.
        faults = sorted(e.errors(include_url=False), key=lambda f: f["type"] != "extra_forbidden")
        more = f" (and {len(faults) - 1} more)" if len(faults) > 1 else ""
        raise ConfigError(f"{where}: {_line(schema, faults[0])}{more}") from None


def dotted(loc: tuple[int | str, ...]) -> str:
    """Write a place in a file as people count: ``("string", 0, "name")`` is ``string[1].name``.

    Examples
    --------
    >>> dotted(("string", 0, "signals", "surface", "3"))
    'string[1].signals.surface.3'
    """
    text = ""
    for part in loc:
        text += f"[{part + 1}]" if isinstance(part, int) else f".{part}" if text else part
    return text


def _in_quotes(given: object, kind: str) -> str | None:
    """Give the number that was written as text; None if it is no number, or fits no number's key."""
    if not isinstance(given, str) or not kind.startswith(("int_", "float_")):
        return None
    text = given.strip()
    if re.fullmatch(r"0[xX][0-9a-fA-F]{1,16}|[+-]?\d{1,18}", text):
        return text
    if re.fullmatch(r"[+-]?\d{1,18}\.\d{1,18}", text):
        return text if kind.startswith("float_") else None
    percent = re.fullmatch(r"(\d{1,6}(?:\.\d{1,6})?) ?%", text)
    return f"{float(percent[1]) / 100:g}" if percent and kind.startswith("float_") else None


def _line(schema: type[BaseModel], fault: Any) -> str:
    loc = tuple(p for p in fault["loc"] if p != "[key]")
    key, kind = clipped(dotted(loc), MOST_SHOWN), fault["type"]
    given = clipped(repr(fault["input"]), MOST_SHOWN)
    if kind == "extra_forbidden":
        return f"{key}: unknown key{did_you_mean(str(loc[-1]), _keys(_at(schema, loc[:-1])))}"
    if kind == "missing":
        return f"{key}: missing"
    if kind in ("model_type", "model_attributes_type", "dict_type"):
        return f"{key}: expected a table, got {given}"
    if kind == "string_too_short":
        return f"{key}: must not be empty"
    if kind == "literal_error":
        choices = [str(c) for c in _choices(_at(schema, loc))]
        return f"{key}: {given} is not known{did_you_mean(str(fault['input']), choices)}"
    message = clipped(one_line(str(fault["msg"])).removeprefix("Value error, "), MOST_SHOWN)
    if kind == "value_error":
        return f"{key}: {message}" if key else message
    valid = ": true or false" if kind in ("bool_type", "bool_parsing") else ""
    if (number := _in_quotes(fault["input"], kind)) is not None:
        valid = f": without quotes, {loc[-1]} = {number}"
    return f"{key}: {given}: {message[:1].lower()}{message[1:]}{valid}"


def _at(annotation: Any, loc: tuple[int | str, ...]) -> Any:
    """Type that the schema expects at a place."""
    for part in loc:
        annotation = _unwrap(annotation)
        if isinstance(annotation, type) and issubclass(annotation, BaseModel):
            field = {(f.alias or name): f for name, f in annotation.model_fields.items()}.get(str(part))
            annotation = field.annotation if field else _of_extra(annotation)
        else:
            arguments = get_args(annotation)
            annotation = arguments[-1] if arguments else None
    return _unwrap(annotation)


def _of_extra(schema: type[BaseModel]) -> Any:
    """Type of the tables that a schema takes under any name; None where it takes none."""
    arguments = get_args(schema.__annotations__.get("__pydantic_extra__"))
    return arguments[-1] if arguments else None


def _unwrap(annotation: Any) -> Any:
    """X of `X | None` and of `Annotated[X, …]`."""
    while True:
        if hasattr(annotation, "__metadata__"):
            annotation = annotation.__origin__
        elif get_origin(annotation) in (Union, UnionType):
            annotation = next(a for a in get_args(annotation) if a is not type(None))
        else:
            return annotation


def _keys(annotation: Any) -> list[str]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [f.alias or name for name, f in annotation.model_fields.items()]
    return []


def _choices(annotation: Any) -> tuple[Any, ...]:
    if get_origin(annotation) is Literal:
        return get_args(annotation)
    return ()
