"""Tests of the lymph node stations of a route."""

from __future__ import annotations

import numpy as np
from phantom_plan import airways, plan, volume

from carina.plan import distance_origin, ebus_landmarks, route_stations
from carina.plan.route_stations import NEXT_TO_MM


def test_stations_of_a_route_are_those_on_the_route_or_next_to_the_target() -> None:
    route = plan().routes[0]
    tree = airways().tree
    origin = distance_origin(volume(), airways())
    found = route_stations(tree, plan(), route)
    assert found
    lineage = {branch.id for branch in tree.lineage(route.branch_id)}
    listed = {(one.landmark.station, one.landmark.branch_id) for one in found}
    for mark in ebus_landmarks(tree, origin=origin):
        if mark.point_lps is None:
            continue
        gap = float(np.linalg.norm(np.array(mark.point_lps) - plan().nodule.centre_lps)) - 0.5 * plan().nodule.long_mm
        on_way = mark.branch_id in lineage and mark.from_carina_mm is not None
        on_way = on_way and mark.from_carina_mm <= route.from_carina_mm + 1.0
        if abs(gap - NEXT_TO_MM) > 6.0:
            assert ((mark.station, mark.branch_id) in listed) == (on_way or gap < NEXT_TO_MM), mark


def test_distances_of_stations_are_measured_from_the_ridge_of_the_main_carina() -> None:
    route = plan().routes[0]
    assert route.origin.kind == "ridge"
    marks = {(m.station, m.branch_id): m for m in ebus_landmarks(airways().tree, origin=route.origin)}
    for one in route_stations(airways().tree, plan(), route):
        known = marks[one.landmark.station, one.landmark.branch_id]
        assert one.landmark.from_carina_mm == known.from_carina_mm
        assert one.to_json()["from_carina_mm"] == known.from_carina_mm
        assert one.relation
        assert one.place_words in one.words
