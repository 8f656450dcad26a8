"""Tests of ``--strict``: every command that opens a scan refuses one with a badge, before it writes anything."""

from __future__ import annotations

import numpy as np
import pytest
import typer
from dicom_writer import series
from scripted_flights import recording_text

from carina.cli.app import app
from carina.volume import open_volume

OPENS = {
    "airways": ("-o", "{}/tree.json"),
    "export": ("-o", "{}/tree.swc"),
    "track": ("--target", "0,0,0", "-o", "{}/path.json"),
    "plan": ("--target", "0,0,0", "-o", "{}/plan.json"),
    "render": ("-o", "{}/picture.png", "--view", "axial", "--at", "0,0,0"),
    "render xray-set": ("-o", "{}/picture.png", "--view", "xray-set"),
    "isoregion": ("-o", "{}/map.nrrd"),
    "fly": ("--to", "1", "-o", "{}/film.mp4"),
    "insert": ("-o", "{}/marked.nii.gz"),
    "score": (),
    "open": ("--no-browser",),
}


@pytest.fixture(scope="module")
def corrected(tmp_path_factory):
    """Return a series with one missing slice, which opens with a badge."""
    folder = tmp_path_factory.mktemp("gap") / "scan"
    series(folder)
    (folder / "IM010").unlink()
    return folder


@pytest.mark.parametrize("command", OPENS)
def test_strict_refuses_a_corrected_scan_before_anything_is_written(carina, corrected, tmp_path, command):
    out = tmp_path / "out"
    out.mkdir()
    options = [text.format(out) for text in OPENS[command]]
    first = [tmp_path / "flight.jsonl"] if command == "score" else []
    for path in first:
        path.write_text(recording_text([np.eye(4)] * 3, open_volume(corrected)))
    ended = carina(command.split()[0], *first, corrected, *options, "--strict", "--json")
    assert ended.code == 3, ended.err
    assert ended.json()["error"]["code"] == "import.strict"
    assert "import.slices-interpolated" in ended.err
    assert list(out.iterdir()) == []


def test_every_command_that_chooses_a_series_has_the_option():
    commands = typer.main.get_command(app).commands
    opening = {name for name, one in commands.items() if any("--ct" in p.opts for p in one.params)}
    assert opening == {name.split()[0] for name in OPENS} | {"info"}
    for name in opening:
        assert any("--strict" in p.opts for p in commands[name].params), name
