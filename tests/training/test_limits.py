"""Tests on both sides of each limit of *in sight*, *seen*, *visited*, contacts and flights that do not count."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from carina.scopes import Pose, WallField, scope_preset
from carina.track import AirwayTree, Branch
from carina.training.attempt_checks import attempt_doubts
from carina.training.flight_frames import FlightFrames, FlightOptics
from carina.training.handling import CentrelineIndex, TipPlaces, hour_text, tip_places, wall_contacts
from carina.training.openings_in_sight import BranchOpening, OpeningSights, openings_in_sight
from carina.training.segment_entries import entries_of, openings_entered, openings_passed
from carina.training.task_file import find_task
from carina.training.visits import Visit, places_seen, progress_steps, revisits_of, visits_of

GENERIC = scope_preset("generic")
AHEAD_Z_MM = 20.0


def field_of(distance, *, long_mm=60):
    """Return a wall field of a function of x, y, z in mm, 1 mm apart."""
    z, y, x = np.mgrid[-10 : long_mm + 1, -30:31, -30:31].astype(np.float32)
    matrix = np.eye(4)
    matrix[:3, 3] = (-30.0, -30.0, -10.0)
    return WallField.from_distances(np.clip(distance(x, y, z), -2.5, 4.5).astype(np.float32), matrix)


# Wall field of a wide lumen whose walls are far from all lines of sight of these tests.
WIDE = field_of(lambda x, _y, _z: 29.0 - np.abs(x))


def frames_of(poses, *, fov_deg=120.0, free=False, complete=True):
    poses = np.array(poses)
    optics = FlightOptics(GENERIC, free, fov_deg, False)
    return FlightFrames(
        poses, np.arange(len(poses)), np.zeros(len(poses), dtype=np.int64), (optics,), complete, poses,
        np.arange(len(poses)) / 10,
    )  # fmt: skip


def camera(at=(0.0, 0.0, 0.0), look=(0.0, 0.0, 1.0)):
    return Pose.looking(at, look, (0.0, -1.0, 0.0) if look[1] == 0.0 else None).lps_from_camera


def disk(radius_mm, at=(0.0, 0.0, AHEAD_Z_MM), into=(0.0, 0.0, 1.0)):
    return BranchOpening(1, "RB1", np.array(at), np.array(into), radius_mm)


def is_in_sight(opening, pose, wall=WIDE, **options):
    return bool(openings_in_sight(frames_of([pose], **options), [opening], wall, first=0, last=0).in_sight[0, 0])


def pixels_of_disk(radius_mm):
    """Return the numbers of pixels of a disk straight ahead, and of the whole round picture, by a pixel loop."""
    optics = GENERIC.lens.optics(64, 64, GENERIC.usual_fov_deg)
    found = total = 0
    for row in range(64):
        for column in range(64):
            if (column - 31.5) ** 2 + (row - 31.5) ** 2 <= 32.0**2:
                total += 1
                x, y, z = optics.directions_of(np.array([[column + 0.5, row + 0.5]]))[0]
                found += z > 0.0 and np.hypot(x, y) / z * AHEAD_Z_MM <= radius_mm
    return found, total


def test_opening_is_in_sight_from_one_percent_of_the_picture():
    sizes = np.arange(1.0, 4.0, 0.05)
    shares = [n / total for n, total in map(pixels_of_disk, sizes)]
    first = int(np.argmax(np.array(shares) >= 0.01))
    # By symmetry a growing disk covers eight more pixels at once, so both shares are near the limit, not at it.
    assert 0.007 < shares[first - 1] < 0.01 <= shares[first] < 0.014
    assert not is_in_sight(disk(float(sizes[first - 1])), camera())
    assert is_in_sight(disk(float(sizes[first])), camera())


@pytest.mark.parametrize(("edge_mm", "expected"), [(-1.0, True), (1.0, False)])
def test_opening_is_in_sight_if_the_wall_hides_less_than_half_of_its_pixels(edge_mm, expected):
    # A plate from z = 8 to 12 mm hides everything on the left of x = edge / 2 at the depth of the opening's lines.
    wall = field_of(lambda x, _y, z: np.where(np.abs(z - 10.0) < 2.0, x - 0.5 * edge_mm, 4.0))
    assert is_in_sight(disk(5.0), camera(), wall) is expected


@pytest.mark.parametrize(("off_deg", "expected"), [(58.5, True), (61.5, False), (66.0, False)])
def test_opening_is_in_sight_if_half_of_its_area_is_in_the_picture(off_deg, expected):
    # The edge of the picture is 60 degrees from the middle. 66 degrees leave more than 1 % of the picture.
    a = np.radians(off_deg)
    side = np.array([np.sin(a), 0.0, np.cos(a)])
    assert is_in_sight(disk(8.0, at=AHEAD_Z_MM * side, into=side), camera()) is expected


@pytest.mark.parametrize(("off_deg", "expected"), [(50.0, True), (75.0, False)])
def test_opening_is_in_sight_only_inside_the_round_picture(off_deg, expected):
    a = np.radians(off_deg)
    assert is_in_sight(disk(3.5), camera(look=(np.sin(a), 0.0, np.cos(a)))) is expected


def test_opening_itself_is_not_in_sight_from_inside_its_branch():
    assert is_in_sight(disk(4.0), camera())
    assert not is_in_sight(disk(4.0, into=(0.0, 0.0, -1.0)), camera())


@pytest.mark.parametrize(("gap_mm", "expected"), [(0.95, True), (0.85, False)])
def test_nothing_is_in_sight_from_a_red_out_of_half(gap_mm, expected):
    # The red-out is one half at 0.375 radii of the tip, 0.92 mm for the generic scope.
    wall = field_of(lambda _x, y, _z: y + gap_mm)
    assert is_in_sight(disk(4.0), camera(), wall) is expected


@pytest.mark.parametrize(("fov_deg", "expected"), [(170.0, False), (120.0, False)])
def test_wider_lens_shows_no_opening_that_the_instrument_does_not_show(fov_deg, expected):
    a = np.radians(72.0)
    assert is_in_sight(disk(3.5), camera(look=(np.sin(a), 0.0, np.cos(a))), fov_deg=fov_deg) is expected


def test_narrow_recorded_picture_hides_what_is_outside_it():
    a = np.radians(40.0)
    pose = camera(look=(np.sin(a), 0.0, np.cos(a)))
    assert is_in_sight(disk(3.5), pose)
    assert not is_in_sight(disk(3.5), pose, fov_deg=50.0)


def sights_of(*runs):
    """Return sights of one opening for each run: first frame, number of frames, distance from the middle."""
    in_sight = np.zeros((60, len(runs)), dtype=bool)
    off = np.full((60, len(runs)), np.inf)
    for k, (start, num, place) in enumerate(runs):
        in_sight[start : start + num, k] = True
        off[start : start + num, k] = place
    return OpeningSights(in_sight, off)


@pytest.mark.parametrize(("num_frames", "expected"), [(5, None), (6, 15)])
def test_segment_is_seen_after_half_a_second_in_sight(num_frames, expected):
    assert places_seen(sights_of((10, num_frames, 0.9)), [[0]]) == [expected]


def test_half_a_second_in_sight_with_an_interruption_does_not_make_a_segment_seen():
    sights = sights_of((10, 9, 0.9))
    sights.in_sight[14] = False
    assert places_seen(sights, [[0]]) == [None]


def test_segment_with_two_openings_is_seen_when_both_are():
    assert places_seen(sights_of((10, 6, 0.9), (30, 6, 0.9)), [[0, 1]]) == [35]
    assert places_seen(sights_of((10, 6, 0.9), (30, 5, 0.9)), [[0, 1]]) == [None]


@pytest.mark.parametrize(("num_frames", "expected"), [(10, []), (11, [Visit(20, 0)])])
def test_segment_is_visited_after_one_second_in_the_middle(num_frames, expected):
    assert visits_of(sights_of((10, num_frames, 0.3)), [[0]]) == expected


@pytest.mark.parametrize(("off", "expected"), [(0.5, [Visit(20, 0)]), (0.51, [])])
def test_segment_is_visited_only_within_half_the_radius_of_the_picture(off, expected):
    assert visits_of(sights_of((10, 20, off)), [[0]]) == expected


def test_opening_nearest_to_the_middle_is_visited():
    assert visits_of(sights_of((10, 20, 0.3), (10, 20, 0.2)), [[0], [1]]) == [Visit(20, 1)]


def runs_of(*runs):
    """Return one array of the values of runs: value and number of frames of each."""
    return np.concatenate([np.full(num, value) for value, num in runs])


@pytest.mark.parametrize(("num_frames", "expected"), [(5, None), (6, 15)])
def test_segment_is_seen_and_visited_after_half_a_second_inside(num_frames, expected):
    passed = runs_of((-1, 10), (0, num_frames), (-1, 50 - num_frames))
    clear = np.ones(60, dtype=bool)
    entered = openings_entered(passed, clear, 1)
    assert entered == [expected]
    assert places_seen(sights_of((0, 0, 0.9)), [[0]], entered) == [expected]
    entries = entries_of(passed, clear, [[0]])
    assert [(one.frame, one.place) for one in entries] == ([] if expected is None else [(expected, 0)])
    assert visits_of(sights_of((0, 0, 0.9)), [[0]], entries) == entries


def test_red_out_interrupts_the_half_second_inside_that_counts_as_an_entry():
    clear = np.ones(60, dtype=bool)
    clear[14] = False
    assert entries_of(runs_of((-1, 10), (0, 9), (-1, 41)), clear, [[0]]) == []


@pytest.mark.parametrize(("num_outside", "expected"), [(5, 1), (6, 2)])
def test_segment_is_entered_again_after_half_a_second_outside(num_outside, expected):
    passed = runs_of((0, 10), (-1, num_outside), (0, 10))
    assert len(entries_of(passed, np.ones(len(passed), dtype=bool), [[0]])) == expected


def test_red_out_inside_a_segment_is_not_an_exit():
    clear = runs_of((True, 10), (False, 20), (True, 10))
    assert len(entries_of(np.zeros(40, dtype=np.int64), clear, [[0]])) == 1


@pytest.mark.parametrize(("z_mm", "branch", "expected"), [(19.9, 1, -1), (20.1, 1, 0), (19.0, 2, 0), (30.0, 0, -1)])
def test_tip_is_inside_past_the_plane_of_the_opening_or_in_a_descendant(z_mm, branch, expected):
    points = np.array([[0.0, 0.0, 10.0], [0.0, 0.0, 40.0], [0.0, 0.0, 60.0], [0.0, 9.0, 60.0]])
    lines = [points[[0, 1]], points[[1, 2]], points[[2, 3]]]
    tree = AirwayTree(
        tuple(
            Branch(n, n - 1 if n else None, (n + 1,) if n < 2 else (), n, None, "tracked", line, np.full(2, 4.0))
            for n, line in enumerate(lines)
        )
    )
    assert openings_passed(np.array([[0.0, 0.0, z_mm]]), np.array([branch]), tree, [disk(4.0)]).tolist() == [expected]


def visits(*places):
    return [Visit(10 * n, place) for n, place in enumerate(places)]


@pytest.mark.parametrize(
    ("flown", "breaks", "ignored"),
    [
        ((0, 1, 2), 3, 3),
        ((1, 2, 3), 2, 2),  # The start is not the place before 1.
        ((0, 1, 0, 2), 2, 3),  # The revisit of 0 is between 1 and 2.
        ((0, 1, 0, 1, 2), 3, 3),  # The move from 0 to 1 counts once.
        ((0, 2, 1), 1, 1),
        ((2, 1, 0), 0, 0),
        ((), 0, 0),
    ],
)
def test_progress_with_a_revisit_is_counted_by_both_rules_breaks_and_ignored(flown, breaks, ignored):
    assert len(progress_steps(visits(*flown), "breaks")) == breaks
    assert len(progress_steps(visits(*flown), "ignored")) == ignored


def test_each_repeated_visit_of_a_place_is_a_revisit():
    assert [visit.place for visit in revisits_of(visits(0, 1, 0, 2, 0, 1))] == [0, 0, 1]


TUBE = field_of(lambda x, y, _z: 4.4 - np.hypot(x, y))


def straight_tree():
    points = np.array([[0.0, 0.0, z] for z in np.arange(0.0, 51.0)])
    return AirwayTree((Branch(0, None, (), 0, "Trachea", "tracked", points, np.full(51, 4.4)),))


def contacts_at(offsets_mm):
    frames = frames_of([camera((x, 0.0, 20.0)) for x in offsets_mm])
    places = TipPlaces(np.zeros(len(offsets_mm), dtype=np.int64), np.zeros(len(offsets_mm), dtype=bool))
    return wall_contacts(frames, TUBE, places, first=0, last=len(offsets_mm) - 1)


def test_tip_touches_the_wall_within_a_tenth_of_a_millimetre():
    # Radius of the tube 4.4 mm, of the tip 2.45 mm: the tip touches from 1.85 mm beside the axis on.
    clear_mm = float(TUBE.ball_mm([[1.6, 0.0, 20.0]])[0])
    assert clear_mm > 2.55
    assert contacts_at([1.6])[0] == []
    assert len(contacts_at([2.2])[0]) == 1
    assert contacts_at([2.2])[0][0].clock_hour == pytest.approx(3.0, abs=0.1)


def test_hour_near_the_top_of_the_picture_is_twelve_o_clock():
    assert [hour_text(hours) for hours in (0.3, 11.8, 12.0, 0.6)] == ["12 o'clock"] * 3 + ["1 o'clock"]


@pytest.mark.parametrize(("num_clear", "expected"), [(4, 1), (5, 2)])
def test_touches_within_half_a_second_are_one_contact(num_clear, expected):
    assert len(contacts_at([2.2] * 3 + [0.0] * num_clear + [2.2] * 3)[0]) == expected


@pytest.mark.parametrize(("off_deg", "expected"), [(29.0, True), (31.0, False)])
def test_lumen_is_in_the_middle_within_a_quarter_of_the_field_of_view(off_deg, expected):
    a = np.radians(off_deg)
    frames = frames_of([camera((0.0, 0.0, 20.0), (np.sin(a), 0.0, np.cos(a)))])
    assert tip_places(frames, CentrelineIndex(straight_tree())).lumen_in_middle.tolist() == [expected]


def doubts_of(poses, wall=WIDE, *, branch=0, **options):
    frames = frames_of(poses, **options)
    last = int(frames.pose_number.size) - 1
    return attempt_doubts(
        frames,
        wall,
        find_task("inspect-all"),
        straight_tree(),
        [0],
        branch_ids=[branch] * (last + 1),
        first=0,
        last=last,
    )


def codes_of(poses, wall=WIDE, **options):
    return [one.code for one in doubts_of(poses, wall, **options)]


@pytest.mark.parametrize(("step_mm", "expected"), [(25.0, []), (99.0, []), (101.0, ["jump"])])
def test_tip_that_moves_faster_than_the_limit_is_reported(step_mm, expected):
    found = doubts_of([camera(), camera((0.0, 0.0, step_mm))], field_of(lambda x, _y, _z: 4.0 + 0.0 * x, long_mm=120))
    assert [one.code for one in found] == expected
    assert all("Carina's limit of 1000 mm/s" in one.words for one in found)


@pytest.mark.parametrize(("wall_mm", "expected"), [(-0.45, []), (-0.55, ["left-airways"])])
def test_tip_outside_the_airways_is_reported(wall_mm, expected):
    assert codes_of([camera(), camera()], field_of(lambda x, _y, _z: wall_mm + 0.0 * x)) == expected


@pytest.mark.parametrize(("thickness_mm", "expected"), [(0.8, []), (1.2, ["jump"])])
def test_hop_through_a_wall_between_two_recorded_positions_is_reported(thickness_mm, expected):
    # A plate across x: both ends of the hop are far inside, and only points between them are in the plate.
    wall = field_of(lambda x, _y, _z: np.abs(x) - thickness_mm / 2.0)
    found = doubts_of([camera((-3.0, 0.0, 0.0)), camera((3.0, 0.0, 0.0))], wall)
    assert [one.code for one in found] == expected
    assert all(one.time_s == 0.1 for one in found)


def test_recorded_position_between_two_frames_outside_the_airways_is_reported():
    frames = frames_of([camera((-3.0, 0.0, 0.0)), camera(), camera((-3.0, 0.0, 0.0))])
    # The frames show the first and the last pose; the second one was recorded between them.
    shown = replace(frames, lps_from_tip=frames.lps_from_tip[[0, 2]], pose_number=np.array([0, 2]))
    wall = field_of(lambda x, _y, _z: np.abs(x) - 1.0)
    found = attempt_doubts(
        shown, wall, find_task("inspect-all"), straight_tree(), [0], branch_ids=[0, 0], first=0, last=1
    )
    assert [one.code for one in found] == ["left-airways"]


@pytest.mark.parametrize(("branch", "expected"), [(0, []), (1, ["start"])])
def test_recording_that_does_not_start_in_the_trachea_is_reported(branch, expected):
    found = doubts_of([camera(), camera()], branch=branch)
    assert [one.code for one in found] == expected
    assert [one.words for one in found] == ["the recording does not start in the trachea"] * len(expected)


def test_incomplete_recording_and_wide_picture_are_reported():
    assert codes_of([camera()], complete=False) == ["incomplete"]
    assert codes_of([camera()], fov_deg=120.4) == []
    assert codes_of([camera()], fov_deg=121.0) == ["wide-picture"]
