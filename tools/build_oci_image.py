"""Build a container image of Carina without a registry and without Docker: an OCI image layout in one tar file.

The image has two layers: the C and C++ libraries of this machine, and the bundle of ``tools/build_bundle.py`` in
``/opt/carina``. It contains no shell and runs as a user without rights. Load it with ``podman load -i FILE`` or
``docker load -i FILE`` (Docker 25 or newer).

Sources: OCI Image Format Specification 1.1 (image layout, index, manifest, configuration, layers).

Run: ``python tools/build_oci_image.py`` after ``tools/build_bundle.py`` (``make bundle``).
"""

from __future__ import annotations

import gzip
import hashlib
import io
import json
import re
import shutil
import subprocess
import sys
import tarfile
import tempfile
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import set_version
from build_bundle import pack

ROOT = Path(__file__).resolve().parent.parent
OUT = ROOT / "dist"
USER = 1000
"""User and group of the image."""
HOME = "home/carina"
PORT = 8765
"""Port of the workstation in the image."""
TYPE = "application/vnd.oci.image"
LIBRARIES = ("c", "m", "dl", "pthread", "rt", "util", "resolv", "nss_files", "nss_dns", "stdc++", "gcc_s")
"""System libraries that the bundle expects on its machine, so that the image must contain them."""


def system_libraries() -> dict[str, Path]:
    """Return the C and C++ libraries of this machine and the loader, by their paths in an image."""
    listed = subprocess.run(["/sbin/ldconfig", "-p"], capture_output=True, text=True, check=True).stdout
    found = {}
    for name, path in re.findall(r"^\s*(\S+) \(libc6,x86-64[^)]*\) => (\S+)", listed, re.MULTILINE):
        if any(re.fullmatch(rf"lib{re.escape(library)}\.so\.\d+", name) for library in LIBRARIES):
            found.setdefault(f"lib/x86_64-linux-gnu/{name}", Path(path))
    found["lib64/ld-linux-x86-64.so.2"] = Path("/lib64/ld-linux-x86-64.so.2")
    return found


def write_base(folder: Path) -> None:
    """Write the lower layer into a folder: libraries, their licences, the user, and folders that can be written."""
    for name, path in system_libraries().items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(path.resolve(), folder / name)
    for package in ("libc6", "libstdc++6", "libgcc-s1"):
        text = Path(f"/usr/share/doc/{package}/copyright")
        if text.is_file():
            (folder / "usr/share/doc" / package).mkdir(parents=True)
            shutil.copy(text, folder / "usr/share/doc" / package)
    (folder / "etc").mkdir()
    (folder / "etc/passwd").write_text(f"carina:x:{USER}:{USER}::/{HOME}:/sbin/nologin\n", encoding="utf-8")
    (folder / "etc/group").write_text(f"carina:x:{USER}:\n", encoding="utf-8")
    (folder / "tmp").mkdir()
    (folder / "tmp").chmod(0o1777)
    (folder / HOME).mkdir(parents=True)


def write_layer(entries: Iterable[tuple[Path, str]], out: Path) -> tuple[str, str]:
    """Write a compressed layer; return the digests of the uncompressed and of the compressed archive."""
    pack(entries, out, {f"./{HOME}": USER})
    with gzip.open(out) as plain:
        inner = hashlib.file_digest(plain, "sha256").hexdigest()
    with out.open("rb") as packed:
        return inner, hashlib.file_digest(packed, "sha256").hexdigest()


def configuration(release: str, python: str, layers: Iterable[str]) -> dict[str, Any]:
    """Return the image's configuration; the layers are the digests of the uncompressed archives."""
    return {
        "architecture": "amd64",
        "os": "linux",
        "config": {
            "User": f"{USER}:{USER}",
            "Env": ["PATH=/opt/carina/bin", f"HOME=/{HOME}", "LANG=C.UTF-8"],
            "Entrypoint": [f"/opt/carina/bin/{python}", "-I", "-m", "carina.cli"],
            "Cmd": ["open", "--no-browser", "--host", "0.0.0.0", "--port", f"{PORT}"],
            "WorkingDir": f"/{HOME}",
            "ExposedPorts": {f"{PORT}/tcp": {}},
            "Volumes": {f"/{HOME}": {}},
            "Labels": {
                "org.opencontainers.image.title": "carina",
                "org.opencontainers.image.version": release,
                "org.opencontainers.image.licenses": "Apache-2.0",
            },
        },
        "rootfs": {"type": "layers", "diff_ids": [f"sha256:{digest}" for digest in layers]},
    }


def write_image(bundle: Path, out: Path, release: str) -> None:
    """Write the image of a bundle as a tar file with an OCI image layout."""
    [python] = [path.name for path in (bundle / "bin").glob("python3*")]
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        base = folder / "base"
        base.mkdir()
        write_base(base)
        layers = []
        for number, (source, name) in enumerate([(base, "."), (bundle, "opt/carina")]):
            path = folder / f"layer{number}.tar.gz"
            layers.append((path, *write_layer([(source, name)], path)))

        blobs: dict[str, Path | bytes] = {digest: path for path, _, digest in layers}

        def stored(document: dict[str, Any]) -> dict[str, Any]:
            data = json.dumps(document, sort_keys=True).encode()
            digest = hashlib.sha256(data).hexdigest()
            blobs[digest] = data
            return {"digest": f"sha256:{digest}", "size": len(data)}

        manifest = {
            "schemaVersion": 2,
            "mediaType": f"{TYPE}.manifest.v1+json",
            "config": {
                "mediaType": f"{TYPE}.config.v1+json",
                **stored(configuration(release, python, [inner for _, inner, _ in layers])),
            },
            "layers": [
                {"mediaType": f"{TYPE}.layer.v1.tar+gzip", "digest": f"sha256:{digest}", "size": path.stat().st_size}
                for path, _, digest in layers
            ],
        }
        index = {
            "schemaVersion": 2,
            "mediaType": f"{TYPE}.index.v1+json",
            "manifests": [
                {
                    "mediaType": f"{TYPE}.manifest.v1+json",
                    **stored(manifest),
                    "platform": {"architecture": "amd64", "os": "linux"},
                    "annotations": {"org.opencontainers.image.ref.name": f"carina:{release}"},
                }
            ],
        }
        with tarfile.open(out, "w", format=tarfile.USTAR_FORMAT) as archive:
            texts: dict[str, Path | bytes] = {
                "oci-layout": json.dumps({"imageLayoutVersion": "1.0.0"}).encode(),
                "index.json": json.dumps(index, sort_keys=True).encode(),
            }
            texts |= {f"blobs/sha256/{digest}": blobs[digest] for digest in sorted(blobs)}
            for name, content in texts.items():
                entry = tarfile.TarInfo(name)
                entry.mode = 0o644
                entry.size = len(content) if isinstance(content, bytes) else content.stat().st_size
                with io.BytesIO(content) if isinstance(content, bytes) else content.open("rb") as file:
                    archive.addfile(entry, file)


def main() -> int:
    """Build the image of the bundle in ``build/bundle`` and write it into ``dist``."""
    release = set_version.current()
    bundle = ROOT / "build" / "bundle" / f"carina-{release}-linux-x86_64"
    if not bundle.is_dir():
        print("no bundle in build/bundle; run: python tools/build_bundle.py", file=sys.stderr)
        return 1
    out = OUT / f"carina-{release}-oci-x86_64.tar"
    write_image(bundle, out, release)
    print(f"{out.relative_to(ROOT)}: {out.stat().st_size / 1e6:.0f} MB")
    return 0


if __name__ == "__main__":
    sys.exit(main())
