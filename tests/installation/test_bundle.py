"""Tests of the bundle and of the container image in ``dist``: they are unpacked, and started without any environment.

Run: ``make wheels bundle test-wheels``.
"""

from __future__ import annotations

import gzip
import hashlib
import json
import os
import shutil
import subprocess
import tarfile
from pathlib import Path
from typing import Any

import pytest
from test_wheels import ROOT, WAIT_S, absent, check_server, run

from carina.version import VERSION

pytestmark = pytest.mark.soak

EXTRAS = ("av", "reportlab", "cryptography", "segno", "pyserial")
EMPTY: dict[str, str] = {}
"""The environment of ``env -i``."""


@pytest.fixture(scope="module")
def bundle(tmp_path_factory) -> Path:
    """Return the unpacked bundle, in a folder whose name contains a space."""
    archive = ROOT / "dist" / f"carina-{VERSION}-linux-x86_64.tar.gz"
    if not archive.is_file():
        absent("no bundle in dist; run: make bundle")
    folder = tmp_path_factory.mktemp("bundle") / "any place"
    with tarfile.open(archive) as packed:
        packed.extractall(folder, filter="data")
    return folder / f"carina-{VERSION}-linux-x86_64"


def test_bundle_starts_without_an_environment_and_includes_all_extras(bundle, tmp_path):
    assert VERSION in run(bundle / "carina", "--version", environment=EMPTY)
    link = tmp_path / "link"
    link.symlink_to(bundle / "carina")
    assert VERSION in run(link, "--version", environment=EMPTY)
    facts = json.loads(run(bundle / "carina", "doctor", "--json", environment={"HOME": str(tmp_path)}))
    assert facts["web_ui"] is True
    missing = [name for name in EXTRAS if f'"{name}": null' in json.dumps(facts)]
    assert not missing
    environment = {"HOME": str(tmp_path)}
    check_server(bundle / "carina", "demo", "phantom", "--no-browser", "--json", environment=environment)


def test_bundle_makes_a_film(bundle, tmp_path):
    program = """
import sys, fractions, av, numpy as np
with av.open(sys.argv[1], "w") as film:
    stream = film.add_stream("libx264", rate=10)
    stream.width = stream.height = 64
    stream.pix_fmt = "yuv420p"
    for level in range(5):
        frame = av.VideoFrame.from_ndarray(np.full((64, 64, 3), 50 * level, np.uint8))
        film.mux(stream.encode(frame))
    film.mux(stream.encode())
"""
    [python] = (bundle / "bin").glob("python3*")
    run(python, "-I", "-c", program, tmp_path / "film.mp4", environment=EMPTY)
    assert (tmp_path / "film.mp4").stat().st_size > 500


def test_bundle_is_added_to_the_menu_of_the_desktop_and_removed(bundle, tmp_path):
    environment = {"HOME": str(tmp_path), "PATH": "/usr/bin:/bin"}
    entry = Path(run(bundle / "add-to-menu", environment=environment).strip())
    assert entry == tmp_path / ".local/share/applications/carina.desktop"
    fields = dict(line.split("=", 1) for line in entry.read_text().splitlines() if "=" in line)
    assert Path(fields["Icon"]).is_file()
    assert Path(fields["Exec"].strip('"')).is_file()
    assert (fields["Type"], fields["Name"]) == ("Application", "Carina")
    run(bundle / "add-to-menu", "--remove", environment=environment)
    assert not entry.exists()


def test_start_script_names_the_required_system_where_its_python_cannot_run(bundle, tmp_path):
    (tmp_path / "bin").mkdir()
    shutil.copy(bundle / "bin" / "carina", tmp_path / "bin")
    [python] = (bundle / "bin").glob("python3*")
    (tmp_path / "bin" / python.name).write_bytes(b"\x7fELF of another system")
    (tmp_path / "bin" / python.name).chmod(0o755)
    ended = subprocess.run(
        [tmp_path / "bin" / "carina"], env=EMPTY, capture_output=True, text=True, check=False, timeout=WAIT_S
    )
    assert ended.returncode == 1
    assert "glibc 2." in ended.stderr
    assert "pip install" in ended.stderr


@pytest.fixture(scope="module")
def layout(tmp_path_factory) -> Path:
    """Return the unpacked image layout."""
    archive = ROOT / "dist" / f"carina-{VERSION}-oci-x86_64.tar"
    if not archive.is_file():
        absent("no image in dist; run: make bundle")
    folder = tmp_path_factory.mktemp("image")
    with tarfile.open(archive) as packed:
        packed.extractall(folder, filter="data")
    return folder


def blob(layout: Path, descriptor: dict[str, Any]) -> bytes:
    """Return a blob whose size and digest are those of its descriptor."""
    algorithm, _, digest = descriptor["digest"].partition(":")
    data = (layout / "blobs" / algorithm / digest).read_bytes()
    assert len(data) == descriptor["size"]
    assert hashlib.new(algorithm, data).hexdigest() == digest
    return data


def test_image_layout_has_right_digests_and_its_entry_point_starts(layout, tmp_path):
    assert json.loads((layout / "oci-layout").read_text()) == {"imageLayoutVersion": "1.0.0"}
    [described] = json.loads((layout / "index.json").read_text())["manifests"]
    manifest = json.loads(blob(layout, described))
    config = json.loads(blob(layout, manifest["config"]))
    assert (config["os"], config["architecture"]) == ("linux", "amd64")
    system = tmp_path / "system"
    for layer, inner in zip(manifest["layers"], config["rootfs"]["diff_ids"], strict=True):
        plain = gzip.decompress(blob(layout, layer))
        assert f"sha256:{hashlib.sha256(plain).hexdigest()}" == inner
        (tmp_path / "layer.tar").write_bytes(plain)
        with tarfile.open(tmp_path / "layer.tar") as packed:
            packed.extractall(system, filter="tar")
        (tmp_path / "layer.tar").unlink()
    started = config["config"]
    user, enter = started["User"], ""
    namespace = ["--mount"] if os.geteuid() == 0 else ["--mount", "--map-root-user"]
    if os.geteuid() == 0:
        for path in (system / "home/carina", system / "tmp"):
            os.chown(path, *map(int, user.split(":")))
        enter = f"--userspec={user}"
    # A container has /proc, by which the loader finds the folder of a program.
    (system / "proc").mkdir()
    places = "PATH=/usr/sbin:/usr/bin:/sbin:/bin"
    chroot = shutil.which("chroot", path="/usr/sbin:/usr/bin")
    script = f'{places} mount --rbind /proc "$0/proc" && exec {chroot} {enter} "$0" "$@"'
    environment = dict(variable.split("=", 1) for variable in started["Env"])
    command = [
        shutil.which("unshare") or "unshare",
        *namespace,
        "/bin/sh",
        "-c",
        script,
        system,
        *started["Entrypoint"],
    ]
    assert VERSION in run(*command, "--version", environment=environment)
    check_server(*command, "demo", "phantom", "--no-browser", "--json", environment=environment)
