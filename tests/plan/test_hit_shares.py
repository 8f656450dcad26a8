"""Test that every output of a plan states the same share of needles that hit, for each route and the planned tool."""

from __future__ import annotations

import dataclasses
import html
import json
import re
from collections import defaultdict
from functools import cache
from unittest.mock import patch

import numpy as np
import pytest
from nodules import ellipsoid
from phantom_plan import CHEST, DAY, RENDERED, airways, volume, wall

from cached_test_data import cached_phantom
from carina.cli.plan import lines
from carina.export.plan_content import drawn_plans
from carina.plan import Plan, Verdict, compare_targets, judge_pairs, plan_route
from carina.plan.report import PlanSheet, make_sheet, write_report
from carina.plan.report.blocks import ReportTable
from carina.plan.report.sections import sections
from carina.plan.target_comparison import HEAD
from carina.scopes import scope_preset
from carina.server.to_wire.plan import _route, _verdict

HITS = re.compile(r"(\d+) % of needle passes hit")
EXPECTED = re.compile(r"expected hits (\d+) %", re.IGNORECASE)
AT_A_GLANCE = re.compile(r"(\d+) % where the CT shows the target")
Shares = dict[str, dict[str, set[str]]]
"""Shares in whole per cent by route, then by the output that states them."""


def per_cent(share: float | None) -> set[str]:
    return set() if share is None else {f"{100 * share:.0f}"}


@cache
def slim_plan() -> Plan:
    """Return a plan with several routes, of which a thin scope points well along the first one."""
    scope = dataclasses.replace(scope_preset("ultrathin"), tip_mm=1.5, channel_mm=2.0)
    centre = cached_phantom(**CHEST).truth["nodule"]["centre_lps"]
    # There is a route to each aim. The plan drives the first one only, so a verdict is the first drive along the other.
    aims = np.array([centre, centre]) + np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 3.0]])
    ball = ellipsoid((6.0, 6.0, 6.0), centre)
    return plan_route(volume(), airways(), ball, scope=scope, wall=wall(), aims=aims, drives=1, confirmed=True)


@cache
def pairs() -> tuple[Verdict, ...]:
    plan = slim_plan()
    return judge_pairs(airways().tree, plan, wall(), scopes=[plan.scope], routes=len(plan.routes))


@cache
def sheet_of(number: int) -> PlanSheet:
    plan = slim_plan()
    verdicts = [one for one in pairs() if one.route_key == plan.routes[number - 1].key]
    with patch.multiple("carina.plan.report.plan_sheet", **RENDERED):
        return make_sheet(volume(), airways(), plan, route_number=number, verdicts=verdicts, made_on=DAY, wall=wall())


def compared_routes(sheet: PlanSheet) -> tuple[str, ...]:
    """Return the hit shares of all routes in the report's table of routes."""
    tables = [block for part in sections(sheet) for block in part.blocks if isinstance(block, ReportTable)]
    (row,) = [row for table in tables for row in table.rows if row[0] == "Needle passes that hit"]
    return tuple(str(cell) for cell in row[1:])


def stated(plan: Plan, tmp_path) -> Shares:
    """Return every hit share that any output states of the routes of a plan."""
    found: Shares = defaultdict(dict)
    table = plan.to_columns()
    text = lines(plan)
    (row,) = compare_targets([plan], ["one"])
    found[plan.routes[0].key]["comparison"] = set(re.findall(r"\d+", row.cells[HEAD.index("hits")]))
    found[plan.routes[0].key]["comparison JSON"] = per_cent(row.to_json()["hit_share"])
    for number, (route, value) in enumerate(
        zip(plan.routes, json.loads(json.dumps(plan.to_json()))["routes"], strict=True), 1
    ):
        own = found[route.key]
        own["Python"] = per_cent(route.hit_share)
        own["plan.json"] = per_cent(value["leg"]["hit_share"])
        own["wire"] = per_cent(_route(route).leg.hit_share)
        own["table"] = per_cent(table["hit_share"][number - 1])
        own["command line"] = set(EXPECTED.findall(" ".join(one for one in text if one.startswith(f"route {number}:"))))
        own["limits"] = set(HITS.findall(" ".join(route.limits)))
        drawn = drawn_plans(plan, airways().tree)[0].routes[number - 1]
        own["export"] = set(EXPECTED.findall(drawn.words))
        sheet = sheet_of(number)
        page = html.unescape(write_report(tmp_path / f"{number}.html", sheet).read_text())
        own["report HTML"] = set(AT_A_GLANCE.findall(page)) | set(HITS.findall(page))
        own["table of routes"] = set(re.findall(r"\d+", compared_routes(sheet)[number - 1]))
        page = html.unescape(write_report(tmp_path / f"{number}-sheet.html", sheet, kind="tracing").read_text())
        own["sheet"] = set(HITS.findall(page)) | set(EXPECTED.findall(page)) | set(AT_A_GLANCE.findall(page))
    for verdict in pairs():
        own = found[verdict.route_key]
        pointing = next((check for check in verdict.checks if check.name == "pointing"), None)
        own["pairs"] = per_cent(None if pointing is None else pointing.share)
        own["pair's text"] = set(HITS.findall(" ".join(check.words for check in verdict.checks)))
        own["pair on the wire"] = set(HITS.findall(str(_verdict(verdict))))
    return found


def test_no_two_hit_shares_of_one_route_differ_between_outputs(tmp_path) -> None:
    plan = slim_plan()
    found = stated(plan, tmp_path)
    first = found[plan.routes[0].key]
    # The first route was driven, so all of these outputs state its share.
    named = {"Python", "plan.json", "wire", "table", "command line", "export", "report HTML", "comparison", "pairs"}
    assert all(first[output] for output in named), [output for output in named if not first[output]]
    assert any(not own["Python"] and own["pairs"] for own in found.values()), "a route is judged only by its verdict"
    for key, own in found.items():
        assert len(set().union(*own.values())) <= 1, (key, own)


def test_share_of_a_driven_route_is_that_of_its_verdict() -> None:
    plan = slim_plan()
    for verdict in pairs():
        route = next(one for one in plan.routes if one.key == verdict.route_key)
        pointing = next((check for check in verdict.checks if check.name == "pointing"), None)
        if route.hit_share is not None:
            assert pointing is not None and pointing.share == pytest.approx(route.hit_share, abs=0.0)
