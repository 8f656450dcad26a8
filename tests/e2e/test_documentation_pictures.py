"""Tests of the pictures in the documents: they show the present window and state the source of the CT."""

from __future__ import annotations

import copy
import re
from typing import Any

import pytest

from make_pictures import COMMAND, ROOT, SHOTS, at_rest, changes, stamp_in, stamp_of, with_stamp

EMBEDDED = re.compile(r"!\[[^\]]*\]\((?!https?:)([^)]+)\)")
PATIENT_DOI = "10.7937/K9/TCIA.2015.NPGZYZBZ"
# These pictures have other checks: a golden test renders the first (tests/examples), `carina bench cluster` draws the
# second, `python -m carina_bench.track_confidence` the third, and a golden test the pictures of the paper's volumes.
MADE_ELSEWHERE = (
    "docs/pictures/gallery/",
    "docs/pictures/cluster/",
    "docs/confidence.svg",
    "docs/pictures/paper/",
    "docs/pictures/guides/",  # tools/make_guide_pictures.py, of a generated chest
)


@pytest.fixture
def opens() -> dict[str, str]:
    return {"demo": "patient"}


@pytest.mark.browser
@pytest.mark.parametrize("shot", [pytest.param(shot, id=shot.path) for shot in SHOTS])
def test_documentation_picture_of_the_window_shows_the_present_window(shot, server, workstation):
    stamp = stamp_in((ROOT / shot.path).read_bytes())
    assert stamp is not None, f"{shot.path} has no stamp. Run {COMMAND}"
    workstation.open(server)
    at_rest(workstation, shot)
    differences = changes(stamp, stamp_of(workstation))
    assert not differences, "\n".join([f"{shot.path} is stale. Run {COMMAND}, and look at what it made.", *differences])
    assert workstation.faults == []


def test_every_picture_in_a_document_has_a_source_and_pictures_of_a_patient_a_citation():
    made = {shot.path: shot for shot in SHOTS}
    shown = set()
    for document in [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]:
        text = document.read_text(encoding="utf-8")
        for found in EMBEDDED.finditer(text):
            path = (document.parent / found[1]).resolve().relative_to(ROOT).as_posix()
            assert (ROOT / path).is_file(), f"{document.name} shows {path}"
            if path.startswith(MADE_ELSEWHERE):
                continue
            assert path in made, f"nothing makes {path}, which {document.name} shows"
            shown.add(path)
            under = text[found.end() :].strip().split("\n\n")[0]
            assert made[path].case != "patient" or PATIENT_DOI in under, f"no citation under {path}"
    assert shown == set(made), "a picture that no document shows"


STAMP: dict[str, Any] = {
    "font": 1400,
    "parts": [
        {"what": "button Path", "look": "rgb(1, 2, 3) 13px", "box": [249, 45, 51, 28]},
        {"what": "span RMB", "look": "rgb(1, 2, 3) 13px", "box": [47, 120, 126, 16]},
    ],
    "colours": {"airway": [100] * 48},
}


def test_comparison_of_window_descriptions_lists_visible_changes_only():
    def changes_after(**change: Any) -> list[str]:
        return changes(STAMP, {**copy.deepcopy(STAMP), **change})

    path, name = STAMP["parts"]
    assert changes_after() == []
    assert changes_after(parts=[path, {**name, "box": [47, 122, 133, 16]}]) == []
    assert changes_after(colours={"airway": [104] * 48}) == []
    assert changes_after(parts=[path, {**name, "what": "span Branch 1"}]) == [
        "gone: span RMB (rgb(1, 2, 3) 13px)",
        "new: span Branch 1 (rgb(1, 2, 3) 13px)",
    ]
    assert len(changes_after(parts=[path, {**name, "look": "rgb(9, 9, 9) 13px"}])) == 2
    assert changes_after(parts=[name, path]) != []
    assert changes_after(parts=[path, name, name]) != []
    assert changes_after(parts=[path, {**name, "box": [47, 220, 126, 16]}])[0].startswith("moved: span RMB")
    assert changes_after(font=1200, parts=[path, {**name, "box": [47, 220, 126, 16]}]) == [], (
        "other fonts, other widths"
    )
    assert "'airway' differs by 60" in changes_after(colours={"airway": [160] * 48})[0]
    assert changes_after(colours={"airway": [100] * 48, "drr": [0] * 48})[0].startswith("views:")


def test_window_description_is_stored_in_the_jpeg_file_without_changing_its_pixels():
    header, rest = b"\xff\xe0\x00\x04JF", b"\xff\xda\x00\x02pixels\xff\xd9"
    bare = b"\xff\xd8" + header + rest
    stamped = with_stamp(bare, STAMP)
    assert stamp_in(bare) is None
    assert stamp_in(stamped) == STAMP
    assert stamped.startswith(b"\xff\xd8" + header)
    assert stamped.endswith(rest)
