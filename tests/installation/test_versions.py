"""Tests of the package's metadata: one version in all files, and no unverified addresses."""

from __future__ import annotations

import json
import re
import tomllib
from pathlib import Path

import set_version
from carina.version import VERSION

ROOT = Path(__file__).resolve().parents[2]


def project(path: str) -> dict:
    return tomllib.loads((ROOT / path).read_text(encoding="utf-8"))


def test_all_files_state_the_version_of_the_workspace():
    version = set_version.current()
    assert version == VERSION
    assert project("pyproject.toml")["project"]["version"] == version
    haptics = project("packages/carina-haptics/pyproject.toml")["project"]
    assert haptics["version"] == version
    assert f"carina=={version}" in haptics["dependencies"]
    assert json.loads((ROOT / "web/package.json").read_text())["version"] == version
    locked = json.loads((ROOT / "web/package-lock.json").read_text())
    assert locked["version"] == locked["packages"][""]["version"] == version
    for name, found in re.findall(r'name = "(carina-[\w-]+)"\nversion = "([^"]+)"', (ROOT / "Cargo.lock").read_text()):
        assert found == version, name


def test_set_version_changes_every_file_that_states_the_version(tmp_path):
    for name in set_version.PLACES:
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_bytes((ROOT / name).read_bytes())
    set_version.change("9.8.7", root=tmp_path)
    assert set_version.current(tmp_path) == "9.8.7"
    for name in set_version.PLACES:
        before, after = (ROOT / name).read_text(), (tmp_path / name).read_text()
        assert before != after
        assert len(before.splitlines()) == len(after.splitlines())


def test_metadata_name_authors_classifiers_and_verified_addresses():
    metadata = project("pyproject.toml")["project"]
    assert metadata["authors"]
    assert any(one.startswith("Programming Language :: Python") for one in metadata["classifiers"])
    # The licence is stated as an SPDX expression, which excludes licence classifiers (PEP 639).
    assert not [one for one in metadata["classifiers"] if one.startswith("License")]
    citation = (ROOT / "python/carina/_cases/CITATION.txt").read_text()
    for address in metadata["urls"].values():
        assert address.removeprefix("https://doi.org/") in citation
