"""Tests of the tools that build wheels, list their parts and compute checksums."""

from __future__ import annotations

import hashlib
import json
import subprocess
from pathlib import Path

import pytest

import build_wheels
import release_documents
from release_documents import Part

ROOT = Path(__file__).resolve().parents[2]


def test_missing_standard_library_is_reported_with_both_remedies():
    reason = build_wheels.missing_target("aarch64-unknown-none", {"PATH": "", "RUSTC": "/bin/false"})
    assert reason is not None
    assert "rustup target add aarch64-unknown-none" in reason
    assert "tools/unpack_debian_rust.sh" in reason


def test_unpacked_compiler_is_preferred_and_has_its_own_target_folder(tmp_path, monkeypatch):
    monkeypatch.setattr(build_wheels, "RUST", tmp_path)
    assert build_wheels.rust_environment({"PATH": "x"}) == {"PATH": "x"}
    (tmp_path / "bin").mkdir()
    (tmp_path / "bin" / "rustc").touch()
    found = build_wheels.rust_environment({"PATH": "x"})
    assert found["RUSTC"] == str(tmp_path / "bin" / "rustc")
    assert found["CARGO_TARGET_DIR"] != str(ROOT / "target")


def test_checksums_are_accepted_by_sha256sum(tmp_path):
    (tmp_path / "one.whl").write_bytes(b"one")
    (tmp_path / "two.whl").write_bytes(b"two")
    text = release_documents.checksums(tmp_path.glob("*.whl"))
    assert text.splitlines()[0] == f"{hashlib.sha256(b'one').hexdigest()}  one.whl"
    subprocess.run(["sha256sum", "-c", "--quiet"], cwd=tmp_path, input=text, text=True, check=True)


def test_list_of_parts_has_package_urls_licences_and_digests_in_a_fixed_order():
    parts = [
        Part("npm", "@scope/name", "1.0", "MIT", None, (("SHA-512", "ab"),)),
        Part("cargo", "libm", "0.2", "MIT"),
        Part("pypi", "numpy", "2.0", ""),
    ]
    document = release_documents.parts_list("1.2.3", parts)
    assert document == release_documents.parts_list("1.2.3", reversed(parts))
    assert json.loads(json.dumps(document)) == document
    assert [one["purl"] for one in document["components"]] == [
        "pkg:cargo/libm@0.2", "pkg:npm/%40scope/name@1.0", "pkg:pypi/numpy@2.0",
    ]  # fmt: skip
    assert document["components"][1]["licenses"] == [{"expression": "MIT"}]
    assert document["metadata"]["component"]["version"] == "1.2.3"


def test_parts_of_the_web_ui_and_of_an_installation_are_found():
    web = {part.name: part for part in release_documents.web_parts()}
    assert web["react"].licence == "MIT"
    python = {part.name for part in release_documents.python_parts()}
    assert {"numpy", "pydicom", "python-gdcm"} <= python
    assert "simpleitk" not in python


def test_licence_text_that_parts_share_is_printed_once(tmp_path):
    for name in ("one", "two"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "LICENSE-MIT").write_text("the text\n")
    parts = [Part("cargo", name, "1.0", "MIT", tmp_path / name) for name in ("one", "two")]
    text = release_documents.licence_document(parts)
    assert text.count("the text") == 1
    assert "one 1.0, two 1.0" in text


def test_list_of_parts_follows_the_schema_and_an_invalid_list_is_reported():
    pytest.importorskip("cyclonedx", reason="only the environment of `make wheels` has the schema")
    document = release_documents.parts_list("1.2.3", [Part("pypi", "numpy", "2.0", "BSD-3-Clause", None)])
    assert release_documents.schema_problem(json.dumps(document)) is None
    document["components"][0]["type"] = "invalid"
    assert "invalid" in release_documents.schema_problem(json.dumps(document))
