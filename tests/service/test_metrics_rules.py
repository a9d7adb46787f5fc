"""The page of metrics, number by number: each of a made-up gateway, in which no two numbers are the same."""

from math import inf, nan
from types import SimpleNamespace

import numpy as np
import pytest

from bms_gateway import __version__
from bms_gateway.bus.port import Counters, Link
from bms_gateway.frames.quality import Quality
from bms_gateway.health.alerts import Severity
from bms_gateway.service import metrics
from bms_gateway.service.exposition import Family, page
from bms_gateway.service.metrics import FLAGS, REASONS, Page
from bms_gateway.service.tally import Histogram, Tally


def forecast(centre, limit_s, hottest):
    centre = np.array(centre)
    limit = np.array(limit_s)
    return SimpleNamespace(
        hottest=hottest,
        centre=centre,
        centre_sd=centre / 100.0,
        limit_s=limit,
        first=None if np.isinf(limit).all() else int(limit.argmin()),
        discharge=np.array([300.0, 200.0, 100.0]),
        charge=np.array([-30.0, -20.0, -10.0]),
    )


def string(name, core, quality, own_heat, conditions=(), ahead=None):
    core = np.array(core)
    return SimpleNamespace(
        plan=SimpleNamespace(name=name),
        core=core,
        core_sd=core / 10.0,
        centre=core[::-1] + 5.0,
        centre_sd=core[::-1] / 20.0,
        quality=np.array(quality),
        own_heat=np.array(own_heat),
        own_heat_sd=np.array(own_heat) / 4.0,
        forecast=ahead,
        health=SimpleNamespace(
            ageing=SimpleNamespace(growth=0.11, growth_sd=0.02),
            cooling=SimpleNamespace(growth=0.33),
            mismatch=SimpleNamespace(excess=6.25),
            conditions=lambda: [SimpleNamespace(code=code, level=level) for code, level in conditions],
        ),
    )


GOOD, ESTIMATED, DOUBTFUL, NEVER = Quality.GOOD, Quality.ESTIMATED, Quality.DOUBTFUL, Quality.NEVER
KNOWN = string(
    "s1",
    [30.0, nan, 40.0, 35.0],
    [GOOD, NEVER, ESTIMATED, ESTIMATED],
    [0.5, nan, 0.25, 2.0],
    [("ageing", 1), ("ageing", 3), ("ageing", 2), ("inlet", 1)],
    forecast([[0.0] * 3, [41.0, 42.0, 43.0], [51.0, 52.0, 53.0], [61.0, 63.0, 62.0]], [inf, 77.0, 99.0], 1),
)
UNKNOWN = string("s2", [nan] * 4, [NEVER] * 4, [nan] * 4)
CALM = string("s3", [20.0] * 2, [DOUBTFUL] * 2, [0.0, -1.0], ahead=forecast([[20.0, 19.0]] * 4, [inf, inf], 0))
LOST = string("s4", [nan] * 2, [NEVER] * 2, [nan] * 2, ahead=forecast([[nan, nan]] * 4, [inf, inf], None))


def families(
    *strings, tally=None, counters=None, link=Link.UP, raised=(), severity=Severity.OK, awake=True, more=(), faults=()
):
    gateway = SimpleNamespace(port=SimpleNamespace(counters=counters or Counters(), link=link), tally=tally or Tally())
    engine = SimpleNamespace(
        frames=501, rejected={"stuck": 7}, strings=strings, faults=faults, next_deadline=lambda: 1 if awake else None
    )
    watch = SimpleNamespace(alerts=SimpleNamespace(raised=raised, severity=severity))
    return list(Page(gateway, lambda: engine, watch, more).families())


def samples(found, *names):
    """Of some families: what stands behind the prefix, with its labels' values, and the number."""
    return {
        (f.name.removeprefix("bms_gateway_") + ending, *labels.values()): value
        for f in found
        for ending, labels, value in f.samples
        if not names or f.name.removeprefix("bms_gateway_") in names
    }


def test_what_went_over_the_bus():
    counters = Counters(
        received=1,
        sent=2,
        dropped=3,
        remote=4,
        malformed=5,
        stale=6,
        overflow=7,
        limited=8,
        impostors=9,
        outages=10,
        clock_steps=11,
        misdated=12,
        errors={"bus-off": 13, "of another class": 14},
    )
    found = samples(families(counters=counters, link=Link.DOWN))
    expected = {
        ("frames_received_total",): 1,
        ("frames_sent_total",): 2,
        ("frames_lost_total",): 3,
        ("frames_ignored_total", "remote"): 4,
        ("frames_ignored_total", "malformed"): 5,
        ("frames_unsent_total", "stale"): 6,
        ("frames_unsent_total", "overflow"): 7,
        ("frames_unsent_total", "limited"): 8,
        ("impostors_total",): 9,
        ("bus_outages_total",): 10,
        ("clock_steps_total",): 11,
        ("frames_misdated_total",): 12,
        ("bus_errors_total", "bus-off"): 13,
        ("bus_errors_total", "of another class"): 14,
        ("bus_errors_total", "protocol"): 0,
        ("bus_up",): 0,
        ("bus_state", "up"): 0,
        ("bus_state", "down"): 1,
        ("bus_state", "absent"): 0,
        ("bus_state", "bus-off"): 0,
    }
    assert {key: found.get(key) for key in expected} == expected
    assert samples(families(), "bus_up", "bus_state")[("bus_up",)] == 1


def test_what_the_service_did(monkeypatch):
    tally = Tally(
        ticks=2,
        lateness=Histogram((0.1, 1.0)),
        wakes=3,
        notices={"x": 4, "y": 5},
        jobs=6,
        jobs_late=7,
        jobs_failed=8,
        saves=9,
        saves_failed=10,
        saved_s=100.0,
        reloads=11,
        reloads_refused=12,
    )
    for lateness in (0.05, 0.5, 0.75, 7.0):
        tally.lateness.note(lateness)
    monkeypatch.setattr(metrics.time, "monotonic", lambda: 113.0)
    found = samples(families(tally=tally))
    expected = {
        ("frames_used_total",): 501,
        ("samples_rejected_total", "stuck"): 7,
        ("samples_rejected_total", "crc"): 0,
        ("awake",): 1,
        ("wakes_total",): 3,
        ("ticks_total",): 2,
        ("tick_lateness_seconds_bucket", "0.1"): 1,
        ("tick_lateness_seconds_bucket", "1.0"): 3,
        ("tick_lateness_seconds_bucket", "+Inf"): 4,
        ("tick_lateness_seconds_sum",): 8.3,
        ("tick_lateness_seconds_count",): 4,
        ("jobs_total",): 6,
        ("jobs_late_total",): 7,
        ("jobs_failed_total",): 8,
        ("state_age_seconds",): 13.0,
        ("state_saves_total",): 9,
        ("state_save_failures_total",): 10,
        ("reloads_total", "taken"): 11,
        ("reloads_total", "refused"): 12,
        ("notices_total", "x"): 4,
        ("notices_total", "y"): 5,
    }
    assert {key: found.get(key) for key in expected} == pytest.approx(expected)
    asleep = samples(families(awake=False))
    assert asleep[("awake",)] == 0
    assert np.isnan(asleep[("state_age_seconds",)])


def test_reasons_are_those_for_which_a_sample_is_refused():
    refused = {"stale", "out_of_range", "not_available", "error", "stuck", "open", "short", "jumpy", "counter", "crc"}
    assert set(REASONS) == refused


def test_the_process(monkeypatch):
    usage = SimpleNamespace(ru_utime=1.25, ru_stime=2.5)
    monkeypatch.setattr(metrics.resource, "getrusage", lambda who: usage if who == 0 else None)
    monkeypatch.setattr(metrics.time, "time", lambda: 1000.0)
    gateway = SimpleNamespace(port=SimpleNamespace(counters=Counters(), link=Link.UP), tally=Tally())
    engine = SimpleNamespace(frames=0, rejected={}, strings=(), faults=(), next_deadline=lambda: None)
    made = Page(gateway, lambda: engine, SimpleNamespace(alerts=SimpleNamespace(raised=(), severity=Severity.OK)))
    monkeypatch.setattr(metrics.time, "time", lambda: 1060.0)
    found = {f.name: f for f in made.families()}
    (version,) = found["bms_gateway_build_info"].samples
    assert (version[1]["version"], version[2]) == (__version__, 1.0)
    assert samples(found.values(), "uptime_seconds") == {("uptime_seconds",): 60.0}
    assert found["process_start_time_seconds"].samples == (("", {}, 1000.0),)
    assert found["process_cpu_seconds_total"].samples == (("", {}, 3.75),)
    assert made().startswith(b"# HELP bms_gateway_build_info Version that runs; always 1.\n")


def test_the_memory_is_the_second_number_of_statm_in_pages_and_left_out_where_it_cannot_be_read(monkeypatch):
    monkeypatch.setattr(metrics.Path, "read_text", lambda self: "9 21 7 1 0 1 0" if "statm" in str(self) else "")
    monkeypatch.setattr(metrics.os, "sysconf", lambda name: 4096 if name == "SC_PAGESIZE" else 0)
    assert metrics.resident_bytes() == 21 * 4096
    for text in ("", "9", "9 x"):
        monkeypatch.setattr(metrics.Path, "read_text", lambda self, text=text: text)
        assert np.isnan(metrics.resident_bytes())


def test_the_hottest_and_coldest_of_each_string_and_nothing_of_what_is_not_known():
    names = ("hottest_point_celsius", "hottest_point_sd_kelvin", "hottest_point_cell")
    names += ("core_max_celsius", "core_max_sd_kelvin", "core_max_cell", "core_min_celsius")
    assert samples(families(KNOWN, UNKNOWN), *names) == {
        ("hottest_point_celsius", "s1"): 45.0,
        ("hottest_point_sd_kelvin", "s1"): 2.0,
        ("hottest_point_cell", "s1"): 2.0,
        ("core_max_celsius", "s1"): 40.0,
        ("core_max_sd_kelvin", "s1"): 4.0,
        ("core_max_cell", "s1"): 3.0,
        ("core_min_celsius", "s1"): 30.0,
    }


def test_cells_by_quality():
    found = samples(families(KNOWN, CALM), "cells")
    assert {key[1:]: value for key, value in found.items() if value} == {
        ("s1", "good"): 1,
        ("s1", "never"): 1,
        ("s1", "estimated"): 2,
        ("s3", "doubtful"): 2,
    }
    assert len(found) == 2 * len(Quality)


def test_the_greatest_heat_that_no_current_makes():
    names = ("unexplained_heat_watts", "unexplained_heat_sd_watts", "unexplained_heat_cell")
    assert samples(families(KNOWN, UNKNOWN, CALM), *names) == {
        ("unexplained_heat_watts", "s1"): 2.0,
        ("unexplained_heat_sd_watts", "s1"): 0.5,
        ("unexplained_heat_cell", "s1"): 4.0,
        ("unexplained_heat_watts", "s3"): 0.0,
        ("unexplained_heat_sd_watts", "s3"): 0.0,
        ("unexplained_heat_cell", "s3"): 1.0,
    }


def test_what_comes_next_of_the_cell_that_will_be_hottest():
    names = (
        "forecast_point_celsius",
        "forecast_point_sd_kelvin",
        "forecast_limit_seconds",
        "permitted_current_amperes",
    )
    found = families(KNOWN, UNKNOWN, CALM, LOST)
    assert {k: v for k, v in samples(found, *names).items() if k[1] == "s1"} == pytest.approx(
        {
            ("forecast_point_celsius", "s1", "60"): 42.0,
            ("forecast_point_celsius", "s1", "300"): 52.0,
            ("forecast_point_celsius", "s1", "600"): 63.0,
            ("forecast_point_sd_kelvin", "s1", "60"): 0.42,
            ("forecast_point_sd_kelvin", "s1", "300"): 0.52,
            ("forecast_point_sd_kelvin", "s1", "600"): 0.63,
            ("forecast_limit_seconds", "s1"): 77.0,
            ("permitted_current_amperes", "s1", "discharge", "10"): 300.0,
            ("permitted_current_amperes", "s1", "discharge", "60"): 200.0,
            ("permitted_current_amperes", "s1", "discharge", "600"): 100.0,
            ("permitted_current_amperes", "s1", "charge", "10"): -30.0,
            ("permitted_current_amperes", "s1", "charge", "60"): -20.0,
            ("permitted_current_amperes", "s1", "charge", "600"): -10.0,
        }
    )
    assert {key[1] for key in samples(found, *names)} == {"s1", "s3"}
    assert set(samples(found, "forecast_limit_seconds")) == {("forecast_limit_seconds", "s1")}


def test_health_and_faults_of_each_string():
    faults = [("s1", None, Quality.STUCK), ("s1", None, Quality.OPEN)]
    found = samples(families(KNOWN, CALM, faults=faults))
    expected = {
        ("inputs_faulty", "s1"): 2,
        ("inputs_faulty", "s3"): 0,
        ("resistance_growth_ratio", "s1"): 0.11,
        ("resistance_growth_sd_ratio", "s1"): 0.02,
        ("cooling_growth_ratio", "s1"): 0.33,
        ("innovation_ratio", "s1"): 2.5,
    }
    assert {key: found.get(key) for key in expected} == expected
    levels = {key[1:]: value for key, value in found.items() if key[0] == "flag_level"}
    assert {key: level for key, level in levels.items() if level} == {("s1", "ageing"): 3, ("s1", "inlet"): 1}
    assert set(levels) == {(name, flag) for name in ("s1", "s3") for flag in FLAGS}


def alert(name, string, severity):
    return SimpleNamespace(name=name, string=string, severity=severity)


def test_alerts_by_severity_and_the_worst_of_each_name_and_string():
    raised = [
        alert("sensor", "s1", Severity.WARNING),
        alert("sensor", "s1", Severity.ALARM),
        alert("sensor", "s1", Severity.WARNING),
        alert("bus", None, Severity.WARNING),
    ]
    found = samples(families(raised=raised, severity=Severity.ALARM), "state", "alerts", "alert")
    assert found == {
        ("state",): 2,
        ("alerts", "warning"): 3,
        ("alerts", "alarm"): 1,
        ("alert", "sensor", "s1"): 2,
        ("alert", "bus", ""): 1,
    }


def test_what_runs_beside_adds_its_families_at_the_end():
    more = Family("more", "gauge", "More.", (("", {}, 1.0),))
    assert families(KNOWN, more=[lambda: iter([more])])[-1] is more


def test_types_and_labels_are_those_that_rules_and_pictures_ask_for():
    found = families(
        replace_forecast(KNOWN), raised=[alert("sensor", "s1", Severity.ALARM)], tally=Tally(notices={"x": 1})
    )
    kinds = {f.name.removeprefix("bms_gateway_"): f.kind for f in found}
    assert {name for name, kind in kinds.items() if kind == "histogram"} == {"tick_lateness_seconds"}
    assert all((kind == "counter") == name.endswith("_total") for name, kind in kinds.items())
    labels = {f.name.removeprefix("bms_gateway_"): set(f.samples[0][1]) for f in found if f.samples and f.samples[0][1]}
    assert labels == {
        "build_info": {"version", "python"},
        "frames_unsent_total": {"reason"},
        "frames_ignored_total": {"reason"},
        "samples_rejected_total": {"reason"},
        "bus_errors_total": {"class"},
        "bus_state": {"state"},
        "tick_lateness_seconds": {"le"},
        "reloads_total": {"result"},
        "notices_total": {"code"},
        "alerts": {"severity"},
        "alert": {"alert", "string"},
        "cells": {"string", "quality"},
        "flag_level": {"string", "flag"},
        "forecast_point_celsius": {"string", "ahead_s"},
        "forecast_point_sd_kelvin": {"string", "ahead_s"},
        "permitted_current_amperes": {"string", "direction", "for_s"},
    } | {
        name: {"string"}
        for name in (
            *("hottest_point_celsius", "hottest_point_sd_kelvin", "hottest_point_cell", "core_max_celsius"),
            *("core_max_sd_kelvin", "core_max_cell", "core_min_celsius", "unexplained_heat_watts"),
            *("unexplained_heat_sd_watts", "unexplained_heat_cell", "inputs_faulty", "resistance_growth_ratio"),
            *("resistance_growth_sd_ratio", "cooling_growth_ratio", "innovation_ratio", "forecast_limit_seconds"),
        )
    }


def replace_forecast(s):
    """The same string with a forecast of its own."""
    return SimpleNamespace(**{**vars(s), "forecast": forecast([[1.0] * 4] * 4, [9.0] * 4, 0)})


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (1.0, "1"),
        (-2.0, "-2"),
        (0.1, "0.1"),
        (inf, "+Inf"),
        (-inf, "-Inf"),
        (999_999_999_999_999.0, "999999999999999"),
        (1e15, "1000000000000000.0"),
        (-1e15, "-1000000000000000.0"),
        (1e300, "1e+300"),
    ],
)
def test_a_number_is_written_so_that_it_can_be_read_back(value, text):
    assert page(iter([Family("x", "gauge", "X.", (("", {}, value),))])).splitlines()[2] == f"x {text}".encode()
    assert float(text) == value


def test_what_is_no_number_is_left_out_and_quotes_are_kept_in_the_help():
    made = page(
        iter([Family("x", "gauge", 'A "b" \\ c\nd.', (("", {}, nan), ("_sum", {"a": 'q"\\\n', "b": ""}, 1.5)))])
    )
    assert made.decode().splitlines() == [
        '# HELP x A "b" \\\\ c\\nd.',
        "# TYPE x gauge",
        'x_sum{a="q\\"\\\\\\n",b=""} 1.5',
    ]
