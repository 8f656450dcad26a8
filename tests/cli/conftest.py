"""Fixtures that run the command line in the test process and return the exit code, stdout and stderr."""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass
from types import SimpleNamespace

import pytest

from cached_test_data import cached_phantom
from carina import Case
from carina import commands as c
from carina.cli import main
from carina.export import VideoWriter
from carina.phantom import write_phantom
from user_folders import user_folders


@dataclass
class Ended:
    """Exit code, standard output and standard error of a finished command."""

    code: int
    out: str
    err: str

    def json(self):
        """Return the single JSON object on stdout; fail if stdout contains other text."""
        value = json.loads(self.out, parse_constant=lambda name: pytest.fail(f"{name} in JSON"))
        assert isinstance(value, dict)
        return value


@pytest.fixture
def carina(monkeypatch, capfd, tmp_path):
    """Return a function that runs ``carina ARGUMENTS`` with temporary user folders."""
    for name, folder in user_folders(tmp_path / "home").items():
        monkeypatch.setenv(name, folder)

    def run(*arguments):
        monkeypatch.setattr(sys, "argv", ["carina", *map(str, arguments)])
        capfd.readouterr()
        with pytest.raises(SystemExit) as end:
            main()
        out, err = capfd.readouterr()
        assert "Traceback" not in err
        code = end.value.code
        return Ended(0 if code is None else code, out, err)

    return run


@pytest.fixture
def pictures_of(monkeypatch):
    """Return a function that returns the pictures of a video file, by the name of the file, before their encoding.

    libx264 encodes the same pictures differently about once in 300 times on a busy machine, even with one thread, so
    tests that compare videos compare these pictures. The function checks that the file contains all of them.
    """
    added = {}
    add = VideoWriter.add

    def record(video, rgb):
        if video.num_frames == 0:
            added[video._path.name] = []
        added[video._path.name].append(rgb.copy())
        add(video, rgb)

    monkeypatch.setattr(VideoWriter, "add", record)

    def pictures(path):
        with pytest.importorskip("av").open(str(path)) as container:
            assert sum(1 for _ in container.decode(video=0)) == len(added[path.name])
        return added[path.name]

    return pictures


@pytest.fixture(scope="session")
def phantom_folder(tmp_path_factory):
    """Return the folder of a phantom with voxels of 2.5 mm, which every test can search, with the main airways."""
    folder = tmp_path_factory.mktemp("phantom")
    write_phantom(cached_phantom(spacing_mm=2.5, generations=4), folder)
    return folder


@pytest.fixture(scope="session")
def ct(phantom_folder):
    """Return the path of the phantom's CT file."""
    return phantom_folder / "ct.nii.gz"


@pytest.fixture(scope="session")
def window_case(phantom_folder, tmp_path_factory):
    """Return the session of an edited case as a window has it, and the file of the case beside its CT."""
    folder = tmp_path_factory.mktemp("window-case")
    ct = folder / "ct.nii.gz"
    ct.write_bytes((phantom_folder / "ct.nii.gz").read_bytes())
    with Case.open(ct) as opened:
        tip = max(opened.airways.tree.tips(), key=lambda branch: branch.generation)
        opened.do(c.ChooseRoute(branch_id=tip.id))
        first = opened.airways.tree.lineage(tip.id)[1]
        opened.do(c.EditTree(c.RenameBranch(first.id, "Own 1")))
        opened.do(c.SetScope("ultrathin"))
        opened.do(c.GoTo(path_mm=30.0))
        path = opened.save(folder / "one")
        yield SimpleNamespace(session=opened._session, path=path, opened=opened, to=str(tip.id))
