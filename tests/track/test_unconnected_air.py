"""Tests of pieces of air that do not touch the lumen: the compiled function equals a plain flood fill."""

from __future__ import annotations

import itertools

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from carina._core import find_pieces_of_air
from carina.track.find.unreached_air import find_islands
from carina.volume import Volume

DARKEST = -900


def plain_pieces(values, lumen, *, box, least_neighbours, voxels, most_air):
    """Return the pieces of air, computed voxel by voxel."""
    (i0, j0, k0), (i1, j1, k1) = box
    inside = list(itertools.product(range(k0, k1), range(j0, j1), range(i0, i1)))
    dark = {at for at in inside if values[at] <= DARKEST}

    def beside(at):
        for axis, step in itertools.product(range(3), (-1, 1)):
            yield (*at[:axis], at[axis] + step, *at[axis + 1 :])

    air = {at for at in dark if lumen[at] == 0 and sum(b in dark for b in beside(at)) >= least_neighbours}
    if len(air) > most_air:
        return []
    lumens = {at for at in inside if lumen[at] != 0}
    left, pieces = set(air), []
    for start in sorted(air):
        if start not in left:
            continue
        left.remove(start)
        piece = [start]
        for at in piece:
            for b in beside(at):
                if b in left:
                    left.remove(b)
                    piece.append(b)
        if voxels[0] <= len(piece) <= voxels[1] and not any(b in lumens for at in piece for b in beside(at)):
            pieces.append(sorted(int(np.ravel_multi_index(at, values.shape)) for at in piece))
    return sorted(pieces, key=len, reverse=True)


@given(st.data())
def test_unconnected_pieces_of_air_equal_those_of_a_plain_flood_fill(data):
    shape = data.draw(st.tuples(*[st.integers(1, 7)] * 3))
    seed = data.draw(st.integers(0, 2**32 - 1))
    rng = np.random.default_rng(seed)
    values = np.where(rng.random(shape) < data.draw(st.floats(0.2, 0.9)), DARKEST, DARKEST + 1).astype(np.int16)
    lumen = (rng.random(shape) < data.draw(st.sampled_from([0.0, 0.02, 0.2]))).astype(np.uint8)
    ends = [sorted(rng.integers(0, n + 1, 2).tolist()) for n in shape[::-1]]
    box = (tuple(low for low, _ in ends), tuple(high for _, high in ends))
    limits = {
        "least_neighbours": data.draw(st.integers(0, 4)),
        "voxels": (data.draw(st.integers(1, 5)), data.draw(st.integers(3, 300))),
        "most_air": data.draw(st.sampled_from([10, 1000])),
    }
    found = find_pieces_of_air(values, lumen, darkest=DARKEST, box_ijk=box, **limits)
    assert [piece.tolist() for piece in found] == plain_pieces(values, lumen, box=box, **limits)


def test_ends_of_a_straight_unconnected_piece_of_air_are_at_its_two_end_faces():
    hu = np.full((40, 30, 30), -500, dtype=np.int16)
    hu[8:32, 14:17, 14:17] = -1000
    volume = Volume(hu, np.diag([1.0, 1.0, 1.0, 1.0]))
    lumen = np.zeros(hu.shape, dtype=np.uint8)
    (piece,) = find_islands(volume, lumen, np.array([[15.0, 15.0, 5.0], [15.0, 15.0, 35.0]]), -900.0)
    assert len(piece.points_lps) == 24 * 9
    ends = sorted(piece.ends, key=lambda end: end.axis_lps[2])
    # The function also returns points between both ends.
    ends = [ends[0], ends[-1]]
    assert [round(float(end.outward[2]), 3) for end in ends] == [-1.0, 1.0]
    assert all(abs(end.radius_mm - 1.69) < 0.5 for end in ends)
    assert np.allclose([end.axis_lps[:2] for end in ends], 15.0, atol=0.5)
    # Air that shares a face with the lumen is not a separate piece.
    lumen[32, 15, 15] = 1
    assert find_islands(volume, lumen, np.array([[15.0, 15.0, 5.0], [15.0, 15.0, 35.0]]), -900.0) == []
