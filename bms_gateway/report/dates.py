"""Times of a table that are not numbers: ISO and German dates, dates with slashes or names of months, times of day.

All become s from the first row.

Two forms look alike and differ by months: 03/04/2026 is the third of April or the fourth of March. The rows decide
between them; otherwise the user is asked.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from typing import Final

import numpy as np

from bms_gateway.thermal import Floats

__all__ = ["ASKED", "DateForm", "date_form"]

ASKED: Final = ("dd/mm/yyyy", "mm/dd/yyyy")
"""What the user may state for a column of dates if its rows do not decide."""
_HALF: Final = r"\s*([AaPp])\.?\s?[Mm]\b\.?"
"""AM or PM, a.m. or p.m., after a time of twelve hours."""
_CLOCK: Final = rf"(\d{{1,2}}):(\d\d)(?::(\d\d)(?:[.,](\d{{1,9}}))?)?(?:{_HALF})?"
_ISO: Final = re.compile(rf"(\d{{4}})[-/](\d\d)[-/](\d\d)(?:[T ]+{_CLOCK}\s*(Z|[+-]\d\d:?\d\d)?)?")
_DOTS: Final = re.compile(rf"(\d{{1,2}})\.(\d{{1,2}})\.(\d{{4}}|\d\d)(?:[ T,]+{_CLOCK})?")
_SLASHES: Final = re.compile(rf"(\d{{1,2}})/(\d{{1,2}})/(\d{{4}}|\d\d)(?:[ T,]+{_CLOCK})?")
_NAMED: Final = re.compile(rf"(\d{{1,2}})[-. /]+([^\W\d_]{{3,9}})[-., /]+(\d{{4}}|\d\d)(?:[ T,]+{_CLOCK})?")
_ALONE: Final = re.compile(rf"(\d{{1,4}}):(\d\d):(\d\d)(?:[.,](\d{{1,9}}))?(?:{_HALF})?")
_MINUTES: Final = re.compile(rf"(\d{{1,2}}):(\d\d)()(){_HALF}")
_SHORT: Final = re.compile(r"\d{1,4}:\d\d(?:[.,]\d+)?")
_MONTHS: Final = {
    "jan": "1", "feb": "2", "mar": "3", "mär": "3", "mrz": "3", "apr": "4", "may": "5", "mai": "5", "jun": "6",
    "jul": "7", "aug": "8", "sep": "9", "oct": "10", "okt": "10", "nov": "11", "dec": "12", "dez": "12",
}  # fmt: skip
"""Months by the first letters of their English and German names."""
_DAY: Final = timedelta(days=1)
_HALF_DAY: Final = timedelta(hours=12)
_EPOCH: Final = datetime(1970, 1, 1)
_NO_DAY: Final = datetime(2000, 1, 1)
"""Forms of times without a date."""


@dataclass(slots=True)
class DateForm:
    """The form in which the times of one column are written, with the time of the first row, which becomes 0 s.

    Attributes
    ----------
    name : str
        Name of the form, such as "ISO dates".
    kind : {"iso", "dots", "named", "day first", "month first", "clock"}
    """

    name: str
    kind: str
    _first: datetime | None = field(default=None)
    _last: datetime | None = field(default=None)
    _zoned: bool | None = field(default=None)
    _halves: bool = field(default=False)

    @property
    def halves(self) -> bool:
        """Whether one of the dates had AM or PM."""
        return self._halves

    @property
    def zoned(self) -> bool:
        """Whether the dates have a time zone."""
        return bool(self._zoned)

    @property
    def began_s(self) -> float | None:
        """Time of the first row: s since 1970 (UTC if no zone is given), or since midnight for times without a date."""
        if self._first is None:
            return None
        return (self._first - (_NO_DAY if self.kind == "clock" else _EPOCH)).total_seconds()

    def seconds(self, cells: Sequence[str]) -> Floats:
        """Convert cells; blank ones are NaN.

        Raises
        ------
        ValueError
            Contains the index of the cell with another form.
        """
        out = np.full(len(cells), np.nan)
        for i, cell in enumerate(cells):
            text = cell.strip()
            if not text:
                continue
            try:
                at = self._after(self._read(text))
            except (ValueError, OverflowError):  # Python's dates have the years 1 to 9999
                raise ValueError(i) from None
            self._first = at if self._first is None else self._first
            self._last = at
            out[i] = (at - self._first).total_seconds()
        return out

    def _after(self, at: datetime) -> datetime:
        """Move a time of day after the previous one, by the days whose midnight has passed."""
        if self.kind != "clock" or self._last is None:
            return at
        beyond = self._last - at - _HALF_DAY
        return at - (-beyond // _DAY) * _DAY if beyond > timedelta(0) else at

    def _read(self, text: str) -> datetime:
        if self.kind == "clock":
            found = _ALONE.fullmatch(text) or _MINUTES.fullmatch(text)
            if found is None or int(found[2]) > 59 or int(found[3] or 0) > 59:
                raise ValueError(text)
            hours, fraction_us = _hour(found[1], found[5], text), _micro(found[4])
            return _NO_DAY + timedelta(
                hours=hours, minutes=int(found[2]), seconds=int(found[3] or 0), microseconds=fraction_us
            )
        pattern = {"iso": _ISO, "dots": _DOTS, "named": _NAMED}.get(self.kind, _SLASHES)
        found = pattern.fullmatch(text)
        if found is None:
            raise ValueError(text)
        a, b, c, hour, minute, second, fraction, half, *zone = (*found.groups(), None)
        y, m, d = {"iso": (a, b, c), "month first": (c, a, b)}.get(self.kind, (c, b, a))
        if self.kind == "named":
            m = _MONTHS.get(m[:3].lower(), "0")  # no month has this number
        year = int(y) + (2000 if len(y) == 2 else 0)
        self._halves |= half is not None
        clock = _hour(hour or "0", half, text), int(minute or 0), int(second or 0), _micro(fraction)
        return self._in_utc(datetime(year, int(m), int(d), *clock), zone[0])

    def _in_utc(self, at: datetime, zone: str | None) -> datetime:
        """Subtract the offset of the time zone; all rows must have one, or none."""
        if self._zoned is None:
            self._zoned = zone is not None
        if self._zoned != (zone is not None):
            raise ValueError(zone)
        if zone is None or zone == "Z":
            return at
        sign = -1 if zone[0] == "-" else 1
        offset = timedelta(hours=int(zone[1:3]), minutes=int(zone[-2:]))
        return (at.replace(tzinfo=UTC) - sign * offset).replace(tzinfo=None)


@dataclass(frozen=True, slots=True)
class _Read:
    """Cells in one order of day and month: times t, s, if all are valid dates, and how many of the first ones are."""

    form: DateForm
    t: Floats
    valid: int
    halves: bool


def date_form(cells: Sequence[str], asked: str | None = None) -> DateForm | str | None:
    """Find the form in which the times of a column are written.

    Parameters
    ----------
    cells : sequence of str
        Cells of the first rows, blank ones too.
    asked : str, optional
        One of `ASKED`, if the user has stated it.

    Returns
    -------
    DateForm, str or None
        None: the cells are not dates, and may be numbers. Text: a sentence that says why the form cannot be found.

    Examples
    --------
    >>> form = date_form(["03.11.2026 23:59:59,5", "04.11.2026 00:00:00"])
    >>> form.name, form.seconds(["03.11.2026 23:59:59,5", "04.11.2026 00:00:00"]).tolist()
    ('German dates', [0.0, 0.5])
    >>> date_form(["1.5", "2.5"]) is None
    True
    """
    given = [c.strip() for c in cells if c.strip()]
    if not given:
        return None
    first = given[0]
    if _ISO.fullmatch(first):
        return DateForm("ISO dates", "iso")
    if _DOTS.fullmatch(first):
        return DateForm("German dates", "dots")
    if (named := _NAMED.fullmatch(first)) and named[2][:3].lower() in _MONTHS:
        return DateForm("dates with names of months", "named")
    if _ALONE.fullmatch(first) or _MINUTES.fullmatch(first):
        return DateForm("hours, minutes and seconds", "clock")
    if _SHORT.fullmatch(first):
        return f"{first!r} may be hours and minutes or minutes and seconds: write it as hh:mm:ss"
    if not (slashes := _SLASHES.fullmatch(first)):
        return None
    if asked is None and len(slashes[3]) == 2:
        how = ASKED[1] if int(slashes[2]) > 12 else ASKED[0]
        return f"{first!r}: which of the numbers is the year is not told; say it: --columns 'time_s=COLUMN [{how}]'"
    if asked is not None:
        return DateForm(f"dates as {asked}", "day first" if asked == ASKED[0] else "month first")
    return _order(given)


def _order(given: Sequence[str]) -> DateForm | str:
    """Decide between day and month: all rows must be valid dates; if they are in both orders, time must go forward."""
    read: list[_Read] = []
    for kind, how in (("day first", ASKED[0]), ("month first", ASKED[1])):
        form = DateForm(f"dates as {how}", kind)
        try:
            t, valid = form.seconds(given), len(given)
        except ValueError as e:
            t, valid = np.empty(0), int(e.args[0])
        read.append(_Read(DateForm(form.name, kind), t, valid, form.halves))
    most = max(r.valid for r in read)
    fits = [r for r in read if r.valid == most]  # the reading of a cell that is no date in either order reports it
    forward = [r for r in fits if (np.diff(r.t) > 0).all()]
    fits = forward or fits  # the reading of a time that goes back in the only order reports it
    usual = [r for r in fits if r.halves]  # AM and PM are used where the month comes first
    unsettled = most < len(given) or not np.array_equal(fits[0].t, fits[-1].t)
    if len(fits) == 2 and not usual and unsettled:
        return (
            f"{given[0]!r}: which is the day and which the month is not told by these rows; say it: "
            f"--columns 'time_s=COLUMN [{ASKED[0]}]'"
        )
    return (fits[-1] if usual else fits[0]).form


def _hour(written: str, half: str | None, text: str) -> int:
    """Return the hour of the day, of a clock beyond 24 h, or of 12 hours with AM or PM."""
    hour = int(written)
    if half is None:
        return hour
    if not 1 <= hour <= 12:
        raise ValueError(text)
    return hour % 12 + (12 if half in "pP" else 0)


def _micro(fraction: str | None) -> int:
    return int(f"{fraction:0<6}"[:6]) if fraction else 0
