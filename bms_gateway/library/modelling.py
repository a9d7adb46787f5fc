"""Model and measurements: `fit`, `compare`, `diagnose` and `add`, with the numbers and words of the commands."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bms_gateway.diagnosis.adding import Addition, add_effects, asked_for, check_signals
from bms_gateway.diagnosis.calibrate import Identified, changes, channel_errors, identify
from bms_gateway.diagnosis.compare import Comparison
from bms_gateway.diagnosis.compare import compare as compared
from bms_gateway.diagnosis.core_band import CoreBand
from bms_gateway.diagnosis.core_known import judged_model
from bms_gateway.diagnosis.detect import absorbed
from bms_gateway.diagnosis.filed import filed_fit
from bms_gateway.diagnosis.findings import refit_sentences
from bms_gateway.diagnosis.record import Record
from bms_gateway.diagnosis.record_finding import Finding
from bms_gateway.diagnosis.record_inputs import Columns
from bms_gateway.diagnosis.verdict_parts import errors
from bms_gateway.errors import DataError, UsageError
from bms_gateway.records.read import read_measurements
from bms_gateway.report.add_text import AddReport, add_document, add_text
from bms_gateway.report.added import added_report
from bms_gateway.report.comparison_text import comparison_document, comparison_text
from bms_gateway.report.diagnosis_text import Told, diagnosis_document, diagnosis_text, placed
from bms_gateway.report.examine import examine, findings_and_notes, long_enough, sound
from bms_gateway.report.fit_text import FitReport, fit_document, fit_text
from bms_gateway.thermal import StringModel

__all__ = ["Added", "Columns", "Compared", "Diagnosed", "Fit", "Record", "add", "compare", "diagnose", "fit"]

Records = Record | Sequence[Record]
Progress = Callable[[float, str], None]
"""Called with the share of the work that is done, 0…1, and the present step."""


@dataclass(frozen=True, slots=True)
class Fit:
    """A fitted model. `str()` is the text that the command `fit` prints.

    Attributes
    ----------
    model : StringModel
        With the identified numbers, their covariance and what is known of its cores.
    report : FitReport
        Numbers before and after (`changes`), errors (`errors`, K), how well the cores are known (`core`).
    """

    model: StringModel
    report: FitReport

    @property
    def cores(self) -> tuple[CoreBand, ...]:
        """Cores of each record: `time_s` (K,), `T_c` (K, n) °C, `total_K` (K, n) sd, `T_centre`, `centre_sd_K`."""
        return self.report.core.bands

    def document(self) -> dict[str, Any]:
        """Return what `fit --json` writes; `model` is empty, for no file was written."""
        return fit_document(self.report)

    def __str__(self) -> str:
        return fit_text(self.report)


@dataclass(frozen=True, slots=True)
class Compared:
    """Model and measurement side by side. `str()` is the text that the command `compare` prints.

    Attributes
    ----------
    comparison : Comparison
        The model as it is (`filed`), and refitted to the records (`refitted`).
    findings, notes : tuple of (source, …)
        What the checks of the records found, and what was assumed while they were made.
    """

    comparison: Comparison
    findings: tuple[tuple[str, Finding], ...]
    notes: tuple[tuple[str, str], ...]

    def document(self) -> dict[str, Any]:
        """Return what `compare --json` writes."""
        return comparison_document(self.comparison, self.findings, self.notes)

    def __str__(self) -> str:
        return comparison_text(self.comparison, self.findings, self.notes)


@dataclass(frozen=True, slots=True)
class Diagnosed:
    """A verdict on a model. `str()` is the text that the command `diagnose` prints.

    Attributes
    ----------
    told : Told
        The verdict with all its reasons.
    """

    told: Told

    @property
    def verdict(self) -> str:
        """`adequate`, `missing_effect`, `undecidable`, `unknown_effect` or `insufficient_data`."""
        return self.told.diagnosis.verdict if self.told.diagnosis else "insufficient_data"

    @property
    def effects(self) -> tuple[str, ...]:
        """Effects that the model lacks, as `add` takes them: `NAME`, or `NAME:CELL`."""
        d = self.told.diagnosis
        return tuple(placed(s.candidate.name, s.candidate.cell) for s in d.selected) if d else ()

    def document(self) -> dict[str, Any]:
        """Return what `diagnose --json` writes."""
        return diagnosis_document(self.told)

    def __str__(self) -> str:
        return diagnosis_text(self.told)


@dataclass(frozen=True, slots=True)
class Added:
    """A model with more effects. `str()` is the text that the command `add` prints.

    Attributes
    ----------
    model : StringModel
        The model with the effects, refitted; the given model if the measurements do not support the effects.
    report : AddReport
        Errors and cores before and after (K), and the numbers of the effects.
    addition : Addition
        The two fits.
    """

    model: StringModel
    report: AddReport
    addition: Addition

    @property
    def refused(self) -> str:
        """Reason against the effects, a sentence; empty if there is none."""
        return self.report.refused

    def document(self) -> dict[str, Any]:
        """Return what `add --json` writes; `model` is empty, for no file was written."""
        return add_document(self.report)

    def __str__(self) -> str:
        return add_text(self.report)


def read_records(
    *files: Path | str,
    model: StringModel,
    config: Path | str | None = None,
    string: str | None = None,
    columns: Mapping[str, str] | None = None,
) -> list[Record]:
    """Read tables (CSV, Parquet) and, with a config, CAN logs, as the commands do.

    Parameters
    ----------
    *files : Path or str
    model : StringModel
        Its sensors, capacity and nominal flow.
    config : Path or str, optional
        Gateway config that says which signals of a log carry what.
    string : str, optional
        String of the config, where it has several.
    columns : mapping of str to str, optional
        Names of a table's own: ``{"current_A": "-I_A"}``; a minus changes the sign.

    Returns
    -------
    list of Record
        One per file.

    Raises
    ------
    UsageError, ConfigError, DataError
        One line: file, place, what is wrong.
    """
    for file in files:
        if not isinstance(file, str | Path):
            raise UsageError(f"read_records: a file is a path, not a {type(file).__name__}; give several one by one")
    if not files:
        raise UsageError("read_records: name at least one table or log")
    place = None if config is None else Path(config)
    return read_measurements(map(Path, files), model=model, config=place, string=string, columns=columns)


def fit(model: StringModel, records: Records, *, calibrate: bool = False) -> Fit:
    """Identify a string model from measurements, as the command `fit` does.

    Parameters
    ----------
    model : StringModel
        The model; the fit starts from its numbers before any data, so that no data count twice.
    records : Record or sequence of Record
        Records of one cell type: they share the physics, and each has its own start and cooling.
    calibrate : bool
        Use thermocouples in the cores too (`core_C` of the columns).

    Returns
    -------
    Fit

    Raises
    ------
    DataError
        Nothing can be learnt from the records, or they have no thermocouple in a core to calibrate with.

    Examples
    --------
    A cell of 60 J/K, 25 mΩ and 8 K/W to the air, under pulses of 15 A:

    >>> import numpy as np
    >>> t, rise = np.arange(1201.0), np.zeros(1201)
    >>> amps = 15.0 * (t // 60 % 2)
    >>> for k in range(1200):
    ...     rise[k + 1] = rise[k] + (0.025 * amps[k] ** 2 - rise[k] / 8.0) / 60.0
    >>> inlet, noise = np.full(1201, 25.0), 0.03 * np.random.default_rng(0).standard_normal(1201)
    >>> drive = Columns(time_s=t, current_A=amps, coolant_inlet_C=inlet, surface_C={1: inlet + rise + noise})
    >>> from bms_gateway.library.models import cell_model
    >>> model = cell_model("21700 5Ah 69g 25mOhm")
    >>> found = fit(model, Record.of(drive, model))
    >>> found.cores[0].T_c.shape == found.cores[0].total_K.shape == (601, 1)
    True
    """
    some = _several(records)
    findings, notes = findings_and_notes(model, some)
    sound(findings)
    for r in some if calibrate else ():
        if not len(r.core.y):
            raise DataError(f"{r.source}: no thermocouple in a core to calibrate with: core_C is empty")
    found = identify(model, some, core=calibrate)
    # earlier statements about effects stay, unless a thermocouple in the core has been used since
    said = model.doubts if model.effects and not calibrate else ()
    written, core = judged_model(found, model, some, said, calibrated=calibrate)
    report = FitReport(
        "",
        tuple(r.source for r in some),
        calibrate,
        changes(found.fit, doubted=core.numbers_doubted),
        absorbed(found.fit).combinations,
        channel_errors(found.fit),
        errors(found.fit),
        found.model_error_K,
        findings,
        notes,
        core,
        () if calibrate else _worse(model, found),
    )
    return Fit(written, report)


def _worse(model: StringModel, found: Identified) -> tuple[str, ...]:
    """Say that the numbers of a fit follow its records less closely than those of the model before."""
    filed = filed_fit(model, found.fit.problem.records, model_error=found.model_error_K > 0.0)
    before, after = ((e.train_rmse_K, e.heldout_rmse_K) for e in (errors(filed), errors(found.fit)))
    return refit_sentences(before, after, found.model_error_K > 0.0)


def compare(model: StringModel, records: Records) -> Compared:
    """Compare a model with measurements, as the command `compare` does: where, when and in which regime it fails.

    Parameters
    ----------
    model : StringModel
    records : Record or sequence of Record

    Returns
    -------
    Compared

    Raises
    ------
    DataError
        The records are too short or have too few readings to be compared.
    """
    some = _several(records)
    findings, notes = findings_and_notes(model, some)
    long_enough(findings)
    return Compared(compared(model, some), findings, notes)


def diagnose(model: StringModel, records: Records, progress: Progress | None = None) -> Diagnosed:
    """Find the physical effect that a model lacks, as the command `diagnose` does.

    Parameters
    ----------
    model : StringModel
        The model; the diagnosis starts from its numbers before any data.
    records : Record or sequence of Record
    progress : callable, optional

    Returns
    -------
    Diagnosed
        Its verdict is `insufficient_data` if nothing can be learnt from the records.
    """
    return Diagnosed(examine(model, _several(records), progress))


def add(
    model: StringModel, records: Records, *effects: str, force: bool = False, progress: Progress | None = None
) -> Added:
    """Add effects of the catalogue to a model and refit it, as the command `add` does.

    Parameters
    ----------
    model : StringModel
    records : Record or sequence of Record
    *effects : str
        `NAME`, or `NAME:CELL` where the effect sits on one cell; several are judged together.
    force : bool
        Add them even if the measurements do not support them; the model file then says so.
    progress : callable, optional

    Returns
    -------
    Added

    Raises
    ------
    ConfigError, UsageError
        An effect or place does not exist, is in the model already or is named twice, or no effect is named.
    DataError
        The records lack what an effect needs.
    """
    wants = asked_for(effects, model)
    some = _several(records)
    findings, notes = findings_and_notes(model, some)
    sound(findings)
    check_signals(wants, some)
    addition = add_effects(model, some, wants, progress)
    report = added_report(addition, some, findings, notes, out="", force=force)
    return Added(addition.model if report.written else model, report, addition)


def _several(records: Records) -> list[Record]:
    some = list(records) if isinstance(records, Sequence) else [records]
    for r in some:
        if not isinstance(r, Record):
            raise UsageError(f"records: {type(r).__name__}: not a Record; make one by Record.of(columns, model)")
    if not some:
        raise UsageError("records: none given")
    return some
