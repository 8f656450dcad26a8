"""Tests of the encoding of strip orders and replies as bytes, and of the refusal of invalid replies."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from carina.cluster.byte_messages import open_answer, open_order, pack_answer, pack_order
from carina.cluster.settings import ClusterSettings
from carina.errors import ClusterError
from carina.render import Picture, RenderStats

COUNTS = (1, 2, 3, 4, 5, 6, 2**40)
BIG = st.integers(0, 2**62)


@given(BIG, BIG, st.binary(max_size=50), st.one_of(st.none(), st.tuples(st.integers(0, 9000), st.integers(1, 9000))))
def test_request_for_a_strip_is_restored_from_its_bytes(frame_id, content, view, rows):
    assert open_order(pack_order(frame_id, content, view, rows)) == (frame_id, content, view, rows)


def _picture() -> Picture:
    stats = RenderStats("leap", 8, 3, 24, 0, 0, 0, 0, 0, 0, 0.0)
    return Picture(np.empty((0, 0, 3), np.uint8), "airway", stats, lps_from_camera=np.eye(4), fov_deg=90.0)


@pytest.mark.parametrize("first_row", [0, 5])
def test_reply_with_a_strip_is_restored_from_its_bytes(first_row):
    rgb = np.random.default_rng(1).integers(0, 256, (3, 8, 3)).astype(np.uint8)
    picture = _picture() if first_row == 0 else None
    strip = (2**40, 7, first_row, 3, 0.125, "leap", COUNTS, picture, rgb)
    *head, found, pixels = open_answer(pack_answer(strip))
    assert tuple(head) == strip[:7]
    assert np.array_equal(pixels, rgb)
    if picture is None:
        assert found is None
    else:
        assert found.fov_deg == 90.0 and np.array_equal(found.lps_from_camera, np.eye(4))


def test_reply_with_noncontiguous_pixel_rows_is_restored_from_its_bytes():
    rgb = np.arange(6 * 8 * 3, dtype=np.uint8).reshape(6, 8, 3)[::2]
    assert np.array_equal(open_answer(pack_answer((1, 1, 3, 3, 0.0, "m", COUNTS, None, rgb)))[-1], rgb)


def test_largest_strip_is_below_the_limit_of_direct_transport():
    """Check that replies stay below 1 MiB, above which they go through shared memory: 9 ms instead of 1 ms."""
    rows = ClusterSettings().max_strip_bytes // (3 * 512)
    strip = (1, 1, 0, rows, 0.0, "leap", COUNTS, _picture(), np.zeros((rows, 512, 3), np.uint8))
    assert len(pack_answer(strip)) < 1_048_576 - 8_192


@pytest.mark.parametrize("rgb", [np.zeros((3, 8), np.uint8), np.zeros((3, 8, 3), np.float32)])
def test_invalid_pixel_array_of_a_strip_is_not_sent(rgb):
    with pytest.raises(ClusterError, match="uint8"):
        pack_answer((1, 1, 5, 3, 0.0, "leap", COUNTS, None, rgb))


@pytest.mark.parametrize(
    "pickled",
    [
        b"cno_such_module\nX\n.",
        b"cbuiltins\nno_such_name\n.",
        b"0.",
        b"h\x05.",
        b"\x80\xff.",
        b"cbuiltins\nint\n(I0\ndR.",
        b"",
    ],
)
def test_reply_whose_picture_cannot_be_unpickled_is_an_invalid_strip(pickled):
    bare = pickle.dumps(_picture(), protocol=5)
    whole = pack_answer((1, 1, 0, 3, 0.0, "leap", COUNTS, _picture(), np.zeros((3, 8, 3), np.uint8)))
    assert bare in whole
    with pytest.raises(ClusterError, match="invalid strip"):
        open_answer(whole.replace(bare, pickled.ljust(len(bare), b"\0")))


def test_reply_with_another_object_than_a_picture_is_an_invalid_strip():
    other = {"view": "airway"}
    with pytest.raises(ClusterError, match="expected an image, found a dict"):
        open_answer(pack_answer((1, 1, 0, 3, 0.0, "leap", COUNTS, other, np.zeros((3, 8, 3), np.uint8))))


@given(st.data())
def test_truncated_extended_or_nonsense_reply_is_an_invalid_strip(data):
    whole = pack_answer((1, 1, 5, 3, 0.0, "leap", COUNTS, None, np.zeros((3, 8, 3), np.uint8)))
    cut = data.draw(st.integers(0, len(whole) - 1))
    with pytest.raises(ClusterError, match="invalid strip"):
        open_answer(whole[:cut])
    with pytest.raises(ClusterError, match="invalid strip"):
        open_answer(whole + b"x" * data.draw(st.integers(1, 9)))
    for nonsense in (None, (1, 2), "text"):
        with pytest.raises(ClusterError, match="invalid strip"):
            open_answer(nonsense)
