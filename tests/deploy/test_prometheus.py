"""Scrape config, rules and dashboard ask only for what is exported, and the rules judge made-up histories right."""

import json
import os
import re
import shutil
import subprocess
from pathlib import Path

import promql_parser as promql
import pytest
import yaml
from prometheus_client.parser import text_string_to_metric_families

from bms_gateway.config.schema import Metrics, Mqtt
from bms_gateway.health.alerts import Condition, Severity
from bms_gateway.service.metrics import FLAGS, Page
from bms_gateway.service.mqtt import Publisher
from bms_gateway.workbench.grafana import UID
from tests.service.pack import Pack

DEPLOY = Path(__file__).resolve().parents[2] / "deploy"
PACKAGE = DEPLOY.parent / "bms_gateway"
RULES = DEPLOY / "prometheus" / "rules.yml"
SCRAPE = DEPLOY / "prometheus" / "scrape.yml"
DASHBOARD = DEPLOY / "grafana" / "bms-gateway.json"
ADDED = {"job", "instance"}
"""Labels that Prometheus adds to whatever it scrapes."""
OPEN = {"string", "alert", "code", "version", "python", "le"}
"""Labels whose values are not known beforehand."""


@pytest.fixture(scope="module")
def exported():
    """Name of each sample that the gateway can export, with the values of its labels; MQTT and an alert among them."""
    pack = Pack(12)
    pack.drive(12)  # the first forecasts have come
    pack.gateway.tally.notices["sensor"] = 1
    pack.gateway.tally.saved_s = 0.0
    pack.watch.alerts.update(1e12, [Condition("sensor", Severity.WARNING, "x", "string_1", settled=True)])
    for s in pack.engine.strings:
        s.health.ageing.growth, s.health.ageing.growth_sd, s.health.cooling.growth = 0.1, 0.02, 0.1
        s.health.mismatch.of.excess[:] = 1.0
        s.newest.heat[:], s.newest.heat_sd[:] = 0.1, 0.05
        s.forecast.limit_s[:] = 300.0
    publisher = Publisher(Mqtt(host="localhost"), {}, status=str, estimates=dict)
    page = Page(pack.gateway, lambda: pack.engine, pack.watch, [publisher.broker.families])
    found = {"up": {}}
    for family in text_string_to_metric_families(page().decode()):
        for sample in family.samples:
            labels = found.setdefault(sample.name, {})
            for key, value in sample.labels.items():
                labels.setdefault(key, set()).add(value)
    return found


def rules():
    return [r for group in yaml.safe_load(RULES.read_text())["groups"] for r in group["rules"]]


def dashboard():
    return json.loads(DASHBOARD.read_text())


def queries():
    """Every expression with the place that it comes from; Grafana's variables replaced as it replaces them."""
    found = [(r["alert"], r["expr"]) for r in rules()]
    for panel in dashboard()["panels"]:
        found += [(panel["title"], target["expr"]) for target in panel["targets"]]
    found += [("annotation", a["expr"]) for a in dashboard()["annotations"]["list"]]
    return [
        (where, e.replace("$__rate_interval", "1m").replace("$instance", ".*").replace("$string", ".*"))
        for where, e in found
    ]


def walk(node):
    """All expressions within one."""
    yield node
    for name in ("lhs", "rhs", "expr", "vector_selector", "param"):
        if (inner := getattr(node, name, None)) is not None:
            yield from walk(inner)
    for inner in getattr(node, "args", None) or ():
        yield from walk(inner)


def selectors(expr):
    return [n for n in walk(promql.parse(expr)) if isinstance(n, promql.VectorSelector)]


def test_every_query_asks_only_for_names_labels_and_values_that_are_exported(exported):
    asked = set()
    for where, expr in queries():
        found = selectors(expr)
        assert found, f"{where}: no metric in {expr}"
        for s in found:
            assert s.name in exported, f"{where}: {s.name} is not exported"
            asked.add(s.name)
            for m in s.matchers.matchers:
                assert m.name in exported[s.name] or m.name in ADDED, f"{where}: {s.name} has no label {m.name}"
                if m.op == promql.MatchOp.Equal and m.name not in ADDED | OPEN:
                    assert m.value in exported[s.name][m.name], f"{where}: {s.name} never has {m.name}={m.value}"
    assert len(asked) > 30


def test_labels_to_group_by_are_there(exported):
    for where, expr in queries():
        for node in walk(promql.parse(expr)):
            if isinstance(node, promql.AggregateExpr) and node.modifier is not None:
                inner = {s.name for s in walk(node.expr) if isinstance(s, promql.VectorSelector)}
                known = ADDED.union(*(exported[name] for name in inner))
                assert set(node.modifier.labels) <= known, f"{where}: {expr}"


def test_counters_are_asked_for_their_growth_and_gauges_for_their_value():
    for where, expr in queries():
        for node in walk(promql.parse(expr)):
            if isinstance(node, promql.Call):
                for arg in node.args:
                    if isinstance(arg, promql.MatrixSelector):
                        name = arg.vector_selector.name
                        grows = name.endswith(("_total", "_bucket"))
                        assert grows is (node.func.name in ("rate", "increase")), f"{where}: {node.func.name}({name})"


def test_nearly_every_metric_is_shown_or_watched(exported):
    asked = {s.name for _, expr in queries() for s in selectors(expr)}
    asked |= {re.sub("_bucket$", end, name) for name in asked for end in ("_sum", "_count")}
    left = set(exported) - asked
    assert left <= {
        "bms_gateway_forecast_point_sd_kelvin",  # the limits on current keep two of it away
        "bms_gateway_bus_state",  # told in words by a rule
        "bms_gateway_mqtt_connects_total",
        "bms_gateway_mqtt_published_total",
        "bms_gateway_notices_total",
        "bms_gateway_reloads_total",
        "bms_gateway_wakes_total",
    }, left


def test_every_rule_says_what_is_wrong_and_what_to_do(exported):
    names = [r["alert"] for r in rules()]
    assert len(set(names)) == len(names) >= 18
    for r in rules():
        assert r["labels"]["severity"] in ("warning", "critical"), r["alert"]
        assert {"summary", "description"} == set(r["annotations"]), r["alert"]
        labels = set().union(*(exported[s.name] for s in selectors(r["expr"]))) | ADDED
        for text in r["annotations"].values():
            assert set(re.findall(r"\$labels\.(\w+)", text)) <= labels, r["alert"]
            for metric in re.findall(r"bms_gateway_\w+", text):
                assert metric in exported, f"{r['alert']}: {metric}"


def test_legends_name_labels_that_are_there_and_panels_do_not_overlap(exported):
    taken = set()
    for panel in dashboard()["panels"]:
        at = panel["gridPos"]
        cells = {(x, y) for x in range(at["x"], at["x"] + at["w"]) for y in range(at["y"], at["y"] + at["h"])}
        assert not cells & taken, panel["title"]
        assert at["x"] + at["w"] <= 24
        taken |= cells
        for target in panel["targets"]:
            labels = set().union(
                *(exported[s.name] for s in selectors(target["expr"].replace("$__rate_interval", "1m")))
            )
            assert set(re.findall(r"{{(\w+)}}", target["legendFormat"])) <= labels | ADDED, panel["title"]
    assert len({p["id"] for p in dashboard()["panels"]}) == len(dashboard()["panels"])


def test_a_string_is_chosen_as_the_live_page_links_to_it(exported):
    assert dashboard()["uid"] == UID
    assert "string" in {v["name"] for v in dashboard()["templating"]["list"]}
    asked = 0
    for panel in dashboard()["panels"]:
        for target in panel["targets"]:
            for s in selectors(target["expr"].replace("$__rate_interval", "1m")):
                if "string" in exported[s.name]:
                    assert ("string", "$string") in {(m.name, m.value) for m in s.matchers.matchers}, panel["title"]
                    asked += 1
    assert asked > 20


def test_the_readme_tells_of_every_metric_and_alert_and_of_no_other(exported):
    text = (DEPLOY / "README.md").read_text(encoding="utf-8")
    table = text.split("<!-- metrics -->")[1].split("<!-- /metrics -->")[0]
    rows = [[cell.strip() for cell in line.split(" | ")] for line in table.strip().splitlines()[2:]]
    names = {f"bms_gateway_{n}" for row in rows for n in re.findall(r"`(\w+)`", row[0])}
    labels = {n for row in rows for n in re.findall(r"`(\w+)`", row[1])}
    known = {re.sub("_(bucket|sum|count)$", "", n) for n in exported if n.startswith("bms_gateway_")}
    assert names == known
    assert labels == {label for n in exported if n.startswith("bms") for label in exported[n]}
    rows = re.findall(r"^\| (`[\w`, ]+`) \| (?:warning|alarm)", text, re.M)
    alerts = {name for row in rows for name in re.findall(r"\w+", row)}
    places = [PACKAGE / "service" / "watch.py", *(PACKAGE / "engine").glob("*.py"), *(PACKAGE / "health").glob("*.py")]
    written = "".join("".join(place.read_text().split()) for place in places)
    found = set(re.findall(r'Condition\("(\w+)"', written)) | set(FLAGS)
    assert alerts == found


def test_the_scrape_config_asks_where_the_gateway_listens():
    job = yaml.safe_load(SCRAPE.read_text())["scrape_configs"][0]
    assert job["static_configs"][0]["targets"] == [Metrics().listen]
    assert job["job_name"] == "bms-gateway"


def promtool(*words, folder):
    program = shutil.which("promtool")
    if program is None:
        why = "no promtool here: apt install prometheus"
        if os.environ.get("CI") == "true":
            pytest.fail(why, pytrace=False)
        pytest.skip(why)
    done = subprocess.run([program, *words], cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.fixture
def folder(tmp_path):
    shutil.copy(RULES, tmp_path / "rules.yml")
    shutil.copy(RULES, tmp_path / "bms-gateway-rules.yml")
    shutil.copy(SCRAPE, tmp_path / "prometheus.yml")
    shutil.copy(Path(__file__).with_name("rules_test.yml"), tmp_path)
    return tmp_path


def test_prometheus_takes_the_files(folder):
    promtool("check", "config", "prometheus.yml", folder=folder)
    promtool("check", "rules", "rules.yml", folder=folder)


def test_the_rules_judge_made_up_histories_right(folder):
    promtool("test", "rules", "rules_test.yml", folder=folder)


def test_prometheus_lints_the_page_itself():
    pack = Pack(12)
    pack.drive(12)  # the first forecasts have come
    page = Page(pack.gateway, lambda: pack.engine, pack.watch)()
    program = shutil.which("promtool")
    if program is None:
        promtool(folder=".")
    done = subprocess.run([program, "check", "metrics"], input=page, capture_output=True, check=False)
    assert done.returncode == 0, (done.stdout + done.stderr).decode()
