"""Tests of turn pictures: the outline shows the opening of the entered branch where no wall covers it."""

from __future__ import annotations

import dataclasses
import math
from functools import cache
from typing import Any

import numpy as np
import pytest
from fork_trees import made_tree, route_in

from cached_test_data import cached_airways, cached_phantom
from carina.display.png import png_bytes
from carina.errors import CancelledError, NoResultError, UsageError
from carina.plan import Turn, TurnList, TurnPicture, turn_list, turn_pictures
from carina.plan.turns.fork_view import AHEAD_DEG, AHEAD_SHARE, HourDoubt
from carina.plan.turns.opening_walls import FOV_DEG, NO_BRANCH, OTHER_BRANCH, ForkWalls
from carina.plan.turns.picture_marks import draw_edge
from carina.plan.turns.pictures import DOUBTFUL_RGB, ROUTE_RGB
from carina.render import AirwayView, Renderer, read_png_pose
from carina.scopes import Lens
from carina_bench.plan_marks import apart, marks_in

CHEST: dict[str, Any] = {"seed": 4, "spacing_mm": 1.2, "generations": 4}
SIZE = 256


@cache
def renderer() -> Renderer:
    made = Renderer(cached_phantom(**CHEST).volume)
    made.set_lumen(cached_airways(**CHEST).lumen_zyx)
    return made


@cache
def turns() -> TurnList:
    """Return the turns to two tips of the phantom, one in each lung, in one list."""
    tree = cached_airways(**CHEST).tree
    ends = [max(tree.tips(), key=lambda tip: sign * float(tip.tip_lps[0])) for sign in (-1.0, 1.0)]
    lists = [turn_list(tree, route_in(tree, end.id), renderer=renderer()) for end in ends]
    return dataclasses.replace(lists[0], turns=lists[0].turns + lists[1].turns)


def pictures_of(found: TurnList, **options: Any) -> tuple[TurnPicture, ...]:
    options = {"size_px": SIZE, "renderer": renderer(), **options}
    return turn_pictures(cached_phantom(**CHEST).volume, cached_airways(**CHEST), found, **options)


@cache
def pictures() -> tuple[TurnPicture, ...]:
    return pictures_of(turns())


def walls(made: TurnPicture) -> np.ndarray:
    view = AirwayView(
        made.camera, fov_deg=FOV_DEG, width=SIZE, height=SIZE, lens=Lens.equidistant(), method="brute", texture=False
    )
    return renderer().surface(view).position_lps


def test_outlined_pixels_of_a_turn_picture_are_wall_of_the_true_entered_branch() -> None:
    tree = cached_airways(**CHEST).tree
    truth = cached_phantom(**CHEST).truth["branches"]
    lines = [(np.array(row["points"]), np.array(row["radius"])) for row in truth]
    for made in pictures():
        assert made.in_view, made.turn
        points = walls(made)[made.outline]
        points = points[np.isfinite(points).all(axis=1)][::7]
        # The points are of the true branch along the tree's branch, and of its descendants.
        daughter = tree.branch(made.turn.to_branch_id)
        middle = daughter.points[len(daughter.points) // 2]
        own = min(range(len(lines)), key=lambda n: np.linalg.norm(lines[n][0] - middle, axis=1).min())
        ours = {truth[own]["id"]}
        for row in truth:
            if row["parent"] in ours:
                ours.add(row["id"])
        gaps = {True: np.full(len(points), np.inf), False: np.full(len(points), np.inf)}
        for row, (line, radius) in zip(truth, lines, strict=True):
            gap = (np.linalg.norm(points[:, None] - line[None], axis=2) - radius).min(axis=1)
            side = row["id"] in ours
            gaps[side] = np.minimum(gaps[side], gap)
        # The tolerance is a millimetre at the opening, where both branches share their wall.
        assert np.mean(gaps[True] <= gaps[False] + 1.0) > 0.97, made.turn


def test_outline_and_arrow_in_the_pixels_have_the_direction_of_the_stated_clock_hour() -> None:
    found = pictures_of(turns(), size_px=512)
    assert sum(made.turn.clock_head is not None for made in found) >= 4
    for made in found:
        marks = marks_in(made.rgb)
        hours = made.turn.clock_head
        if hours is None:
            assert marks.arrow_clock_hour is None, made.turn
            assert marks.is_centre_inside or not made.turn.straight_ahead, made.turn
            continue
        assert marks.apart_hours is not None and marks.apart_hours <= 0.25, made.turn
        assert marks.ostium_clock_hour is not None
        assert apart(marks.ostium_clock_hour, hours) <= 0.25, made.turn
        assert apart(marks.ostium_clock_hour, float(made.turn.hour("head") or 0)) <= 0.75, made.turn


def test_picture_of_a_turn_with_an_unreliable_clock_hour_has_no_arrow_and_states_no_hour() -> None:
    turn = next(one for one in turns().turns if one.clock_head is not None)
    doubt = HourDoubt("turns.neighbour", "no clock hour: RB9 opens in nearly the same direction; compare the picture")
    unsure = dataclasses.replace(turn, clock_head=None, clock_facing=None, hour_doubt=doubt)
    (sure,), (made,) = (pictures_of(dataclasses.replace(turns(), turns=(one,))) for one in (turn, unsure))
    assert "o\u2019clock" in sure.words and made.words == f"{turn.to_branch}, no clock hour"
    assert np.array_equal(made.outline, sure.outline)
    at = {tuple(int(v) for v in rgb) for rgb in made.rgb.reshape(-1, 3)}
    assert DOUBTFUL_RGB in at and ROUTE_RGB not in at


def test_middle_of_the_opening_is_inside_its_outline() -> None:
    for made in pictures():
        assert made.turn.opening_lps is not None
        at = made.picture.pixel_of(made.turn.opening_lps)
        assert at is not None and made.outline[int(at[1]), int(at[0])], made.turn


def test_dots_of_the_route_are_inside_the_outline_and_lead_away_from_the_camera() -> None:
    assert max(len(made.turn.dots_lps) for made in pictures()) > 2
    for made in pictures():
        dots = np.array(made.turn.dots_lps)
        assert dots[0] == pytest.approx(made.turn.opening_lps)
        depths = np.linalg.norm(dots - made.camera.position_lps, axis=1)
        assert (np.diff(depths) > 0.0).all()
        pixels = [made.picture.pixel_of(dot) for dot in dots]
        inside = [at is not None and bool(made.outline[int(at[1]), int(at[0])]) for at in pixels]
        assert all(inside), made.turn
        # No wall is between the camera and a dot of the route.
        walls_mm = np.linalg.norm(walls(made) - made.camera.position_lps, axis=-1)
        for depth, at in zip(depths[1:], pixels[1:], strict=True):
            assert at is not None and not depth > walls_mm[int(at[1]), int(at[0])] + 2.0, made.turn


def test_opening_within_half_its_radius_of_the_middle_is_straight_ahead() -> None:
    views = [(made, np.array(made.turn.opening_lps) - made.camera.position_lps) for made in pictures()]
    for made, seen in views:
        off_deg = math.degrees(math.acos(float(seen @ made.camera.forward_lps / np.linalg.norm(seen))))
        assert made.turn.ahead_deg >= AHEAD_DEG
        assert not made.turn.straight_ahead or off_deg <= made.turn.ahead_deg
        radius_deg = FOV_DEG * math.sqrt(float(made.outline.mean()) / math.pi)
        assert made.turn.ahead_deg == pytest.approx(max(AHEAD_DEG, AHEAD_SHARE * radius_deg), abs=1.0)


def test_openings_of_other_branches_are_outside_the_outline() -> None:
    tree = cached_airways(**CHEST).tree
    for made in pictures():
        for other in made.turn.others:
            branch = tree.branch(other.branch_id)
            # The point is well inside the branch; the picture may not show it.
            place = branch.points[len(branch.points) // 2]
            at = made.picture.pixel_of(place)
            if at is None or not (0 <= at[0] < SIZE and 0 <= at[1] < SIZE):
                continue
            wall = walls(made)[int(at[1]), int(at[0])]
            eye = made.camera.position_lps
            if np.linalg.norm(wall - eye) > np.linalg.norm(place - eye):
                assert not made.outline[int(at[1]), int(at[0])], (made.turn, other)


def test_turn_picture_for_an_operator_facing_the_patient_is_rotated_by_180_degrees() -> None:
    for head, facing in zip(pictures(), pictures_of(turns(), operator="facing"), strict=True):
        turned = facing.outline[::-1, ::-1]
        # Rays of the rotated picture sample the wall at slightly different points, so the test compares every second
        # pixel.
        both = np.mean(turned != head.outline)
        assert both < 0.01
        assert np.allclose(facing.camera.right_lps, -head.camera.right_lps)


def test_branch_begins_where_its_centreline_has_left_the_lumens_of_parent_and_siblings() -> None:
    def tube(number: int, a: list[float], b: list[float], radius: float) -> dict[str, Any]:
        parent, children = (0, []) if number else (None, [1, 2])
        points = np.linspace(np.array(a, dtype=float), np.array(b, dtype=float), 41)
        return {"id": number, "parent": parent, "children": children, "points": points, "radius": np.full(41, radius)}

    # The side branch is the widest, so a ball of its width at the fork would include the opposite wall.
    fork = [0.0, 0.0, 0.0]
    tree = made_tree([tube(0, [0, 0, 20], fork, 4.0), tube(1, fork, [0, 0, -20], 4.0), tube(2, fork, [20, 0, 0], 4.6)])
    opposite, inside, mother, sister = [-4.0, 0.0, 0.0], [12.0, 4.6, 0.0], [0.0, 4.0, 12.0], [0.0, -4.0, -12.0]
    walls = ForkWalls(tree, np.array(fork), [2])
    owners = walls.owners(np.array([[opposite, inside, mother, sister, [np.nan] * 3]]))
    assert owners.tolist() == [[OTHER_BRANCH, 0, OTHER_BRANCH, OTHER_BRANCH, NO_BRANCH]]


def hidden(turn: Turn) -> Turn:
    """Return the turn with its camera in the other lung, so that tissue covers the opening."""
    tree = cached_airways(**CHEST).tree
    away = max(tree.tips(), key=lambda tip: float(np.linalg.norm(tip.tip_lps - np.array(turn.fork_lps))))
    eye = away.points[len(away.points) // 2]
    return dataclasses.replace(turn, seen_from_lps=(float(eye[0]), float(eye[1]), float(eye[2])))


def test_opening_behind_a_wall_is_not_outlined_and_reported_as_not_in_view() -> None:
    far = dataclasses.replace(turns(), turns=(hidden(turns().turns[2]),))
    (made,) = pictures_of(far)
    assert not made.in_view and not made.outline.any()
    assert "not in view" in made.words
    plain = pictures_of(far, marked=False)[0].rgb
    middle = slice(SIZE // 4, 3 * SIZE // 4)
    assert np.array_equal(made.rgb[middle, middle], plain[middle, middle]), "nothing is drawn where it would be"


def test_outline_of_an_opening_has_the_colour_of_the_route_or_of_a_doubtful_branch() -> None:
    turn = turns().turns[1]
    doubted = dataclasses.replace(turn, doubts=("it was drawn by hand",))
    for one, colour, other in ((turn, ROUTE_RGB, DOUBTFUL_RGB), (doubted, DOUBTFUL_RGB, ROUTE_RGB)):
        (made,) = pictures_of(dataclasses.replace(turns(), turns=(one,)))
        at = {tuple(int(v) for v in rgb) for rgb in made.rgb.reshape(-1, 3)}
        assert colour in at and other not in at


@pytest.mark.parametrize("radius_px", [15.0, 40.0, 90.0])
def test_outline_is_drawn_with_the_same_line_width_at_every_radius(radius_px: float) -> None:
    rows, columns = np.mgrid[0:256, 0:256] + 0.5 - 128
    field = 1.0 / (1.0 + np.exp((np.hypot(rows, columns) - radius_px) / 2.0))
    rgb = np.zeros((256, 256, 3), dtype=np.uint8)
    draw_edge(rgb, field, 3.0, (200, 200, 200))
    covered = (rgb[..., 0].astype(float) - 8.0).clip(0.0) / 192.0
    assert covered.sum() / (math.tau * radius_px) == pytest.approx(3.0, abs=0.35)


def test_saved_turn_picture_contains_its_camera_pose(tmp_path: Any) -> None:
    made = pictures()[1]
    path = tmp_path / "turn.png"
    path.write_bytes(made.png())
    place = read_png_pose(path)
    assert place is not None
    assert np.allclose(place["lps_from_camera"], made.camera.lps_from_camera)
    assert made._repr_png_() == made.png()
    assert len(made.png()) > len(png_bytes(np.ascontiguousarray(made.rgb)))


def test_turn_pictures_have_no_fine_texture_and_unmarked_ones_no_outline() -> None:
    made, plain = pictures()[1], pictures_of(dataclasses.replace(turns(), turns=turns().turns[1:2]), marked=False)[0]
    view = AirwayView(
        made.camera, fov_deg=FOV_DEG, width=SIZE, height=SIZE, lens=Lens.equidistant(), method="brute", texture=False
    )
    assert np.array_equal(plain.rgb, renderer().render(view).rgb)
    assert not np.array_equal(plain.rgb, made.rgb)
    assert np.array_equal(plain.outline, made.outline)


def test_turn_picture_with_invalid_arguments_is_refused() -> None:
    with pytest.raises(UsageError):
        pictures_of(turns(), size_px=10)
    blind = dataclasses.replace(turns().turns[0], seen_from_lps=None)
    with pytest.raises(NoResultError):
        pictures_of(dataclasses.replace(turns(), turns=(blind,)))
    with pytest.raises(CancelledError):
        pictures_of(turns(), cancel=lambda: True)
    assert pictures_of(dataclasses.replace(turns(), turns=())) == ()
    shares: list[float] = []
    pictures_of(
        dataclasses.replace(turns(), turns=turns().turns[:2]),
        progress=lambda _what, share: shares.append(share),
        size_px=128,
    )
    assert shares == [0.5, 1.0]
