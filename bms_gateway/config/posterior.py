"""`[posterior]` of a model file: further results of a fit to whole records, and whether the core is proven.

`[parameters]`, the effects' tables and `[correlation]` hold medians, standard deviations and correlations. This table
repeats the medians and standard deviations, so that numbers which were changed by hand are noticed: the statement about
the core does not hold for them.
"""

import json
from collections.abc import Mapping

import numpy as np
from pydantic import Field

from bms_gateway.config.toml import Section
from bms_gateway.errors import ConfigError
from bms_gateway.thermal import Posterior, StringModel

SAME = 1e-6
"""Relative difference that rounding and the conversion of units may make."""
AGAIN = "run fit or add again, or remove [posterior] and what was learnt with it"


class PosteriorTable(Section):
    """`[posterior]`."""

    names: list[str]
    values: list[float]
    sd: list[float]
    model_error_K: float = Field(default=0.0, ge=0.0)
    core_doubt: float = Field(default=0.0, ge=0.0)
    calibrated: bool = False
    core_proven: bool
    not_proven: list[str] = Field(default_factory=list)


def read_posterior(given: PosteriorTable, model: StringModel) -> Posterior:
    """Read the table of a model whose other keys are read.

    Raises
    ------
    ConfigError
        The table contradicts itself, or numbers of the model were changed since the fit.
    """
    for key in ("values", "sd"):
        if len(getattr(given, key)) != len(given.names):
            raise ConfigError(f"posterior.{key}: {len(given.names)} names need {len(given.names)} numbers; {AGAIN}")
    if given.core_proven and given.not_proven:
        raise ConfigError(f"posterior.core_proven: true, yet not_proven says {given.not_proven[0]!r}; {AGAIN}")
    if not given.core_proven and not given.not_proven:
        raise ConfigError(f"posterior.not_proven: empty, yet core_proven is false; {AGAIN}")
    values, sd = (dict(zip(given.names, x, strict=True)) for x in (given.values, given.sd))
    for now, then, what in zip(model.free_numbers, (values, sd), ("", "'s sd"), strict=True):
        _unchanged(now, then, what)
    return Posterior(values, sd, given.model_error_K, given.core_doubt, given.calibrated, tuple(given.not_proven))


def write_posterior(p: Posterior) -> list[str]:
    """Write the lines of the table."""
    why = ["not_proven = [", *(f"  {json.dumps(text, ensure_ascii=False)}," for text in p.not_proven), "]"]
    return [
        "",
        "[posterior]  # the numbers above (SI) and whether they prove the core: it goes when one is changed by hand",
        f"names = {json.dumps(list(p.values))}",
        f"values = {[float(x) for x in p.values.values()]}",
        f"sd = {[float(x) for x in p.sd.values()]}  # of the logarithm where it is known in per cent",
        f"model_error_K = {float(p.model_error_K)!r}  # slow error of a surface that the model was given",
        f"core_doubt = {float(p.core_doubt)!r}  # share of core minus surface that may be wrong beyond these numbers",
        f"calibrated = {json.dumps(p.calibrated)}  # by a thermocouple in the core",
        f"core_proven = {json.dumps(not p.not_proven)}",
        *(why if p.not_proven else []),
    ]


def _unchanged(now: Mapping[str, float], then: Mapping[str, float], what: str) -> None:
    for name in dict.fromkeys([*now, *then]):
        if name not in then:
            raise ConfigError(f"posterior.names: {name} is missing; {AGAIN}")
        if name not in now:
            raise ConfigError(f"posterior.names: {name!r} is no free number of this model any more; {AGAIN}")
        if not np.isclose(now[name], then[name], rtol=SAME, atol=0.0):
            raise ConfigError(f"{name}{what} was {then[name]:g} when it was fitted (SI), and is {now[name]:g}; {AGAIN}")
