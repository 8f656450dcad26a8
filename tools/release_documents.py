"""Write the documents of a release: licences of all parts, a list of all parts (SBOM), and checksums.

A wheel contains compiled Rust crates and the libraries of the web UI. Their licence texts are collected from the
sources on this machine into ``python/carina/_licences/parts.txt``, which the wheel includes. The SBOM (CycloneDX 1.6)
lists these parts and the Python packages of ``requirements-run.lock``, which an installation downloads.

Run: ``python tools/release_documents.py licences`` before the wheels are built, and
``python tools/release_documents.py sums`` afterwards (both are parts of ``make wheels``).
"""

from __future__ import annotations

import base64
import hashlib
import json
import re
import subprocess
import sys
import tomllib
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import set_version

ROOT = Path(__file__).resolve().parent.parent
LICENCES = ROOT / "python" / "carina" / "_licences" / "parts.txt"
OUT = ROOT / "dist"
TARGETS = ("x86_64-unknown-linux-gnu", "aarch64-unknown-linux-gnu")
TEXTS = re.compile(r"(licen[sc]e|copying|notice|unlicense)", re.IGNORECASE)
"""Pattern of the start of the name of a file with a licence text."""


@dataclass(frozen=True, slots=True, order=True)
class Part:
    """A library that is part of a wheel, or that an installation downloads."""

    kind: str
    """``cargo``, ``npm`` or ``pypi``, as in a package URL."""
    name: str
    version: str
    licence: str
    """SPDX expression; empty if only the package itself states it."""
    folder: Path | None = None
    """Folder of the sources on this machine."""
    digests: tuple[tuple[str, str], ...] = ()
    """Algorithm and hexadecimal digest of the package's file."""

    def to_cyclonedx(self) -> dict[str, Any]:
        """Return the part as a component of CycloneDX."""
        name = self.name.replace("@", "%40", 1)
        address = f"pkg:{self.kind}/{name}@{self.version}"
        found: dict[str, Any] = {
            "type": "library", "bom-ref": address, "name": self.name, "version": self.version, "purl": address,
        }  # fmt: skip
        if self.licence:
            found["licenses"] = [{"expression": self.licence}]
        if self.digests:
            found["hashes"] = [{"alg": name, "content": digest} for name, digest in self.digests]
        return found


def rust_parts() -> list[Part]:
    """Return the crates of other authors that the compiled module contains, on any of the processors."""
    used: set[tuple[str, str]] = set()
    for target in TARGETS:
        command = ["cargo", "tree", "--locked", "-p", "carina-bindings", "--features", "extension-module,gpu"]
        command += ["-e", "normal,no-proc-macro", "--target", target, "--prefix", "none", "--format", "{p}"]
        listed = subprocess.run(command, cwd=ROOT, check=True, capture_output=True, text=True).stdout
        used |= {(words[0], words[1].removeprefix("v")) for line in listed.splitlines() if (words := line.split())}
    command = ["cargo", "metadata", "--locked", "--format-version", "1", "--all-features"]
    metadata = json.loads(subprocess.run(command, cwd=ROOT, check=True, capture_output=True, text=True).stdout)
    sums = {
        (entry["name"], entry["version"]): entry["checksum"]
        for entry in tomllib.loads((ROOT / "Cargo.lock").read_text(encoding="utf-8"))["package"]
        if "checksum" in entry
    }
    found = []
    for crate in metadata["packages"]:
        key = crate["name"], crate["version"]
        if key in used and key in sums:  # the crates of the project have no checksum
            licence = str(crate["license"] or "").replace("/", " OR ")
            folder = Path(crate["manifest_path"]).parent
            found.append(Part("cargo", *key, licence, folder, (("SHA-256", sums[key]),)))
    return found


def web_parts() -> list[Part]:
    """Return the npm packages that the web UI contains: those that are not only for development."""
    locked = json.loads((ROOT / "web" / "package-lock.json").read_text(encoding="utf-8"))["packages"]
    found = []
    for path, entry in locked.items():
        folder = ROOT / "web" / path
        if not path or entry.get("dev") or entry.get("optional") or not folder.is_dir():
            continue
        name = path.rpartition("node_modules/")[2]
        algorithm, _, digest = entry["integrity"].partition("-")
        assert algorithm == "sha512", path
        digests = (("SHA-512", base64.b64decode(digest).hex()),)
        found.append(Part("npm", name, entry["version"], entry.get("license", ""), folder, digests))
    return found


def python_parts() -> list[Part]:
    """Return the Python packages that an installation downloads."""
    text = (ROOT / "requirements-run.lock").read_text(encoding="utf-8")
    return [
        Part("pypi", name, version, "") for name, version in re.findall(r"^([\w.-]+)==([\w.]+)", text, re.MULTILINE)
    ]


def licence_texts(folder: Path) -> list[str]:
    """Return the licence texts in the top folder of a part."""
    files = sorted(file for file in folder.iterdir() if file.is_file() and TEXTS.match(file.name))
    return [file.read_text(encoding="utf-8", errors="replace").strip() for file in files]


def licence_document(parts: Iterable[Part]) -> str:
    """Return the licences of all parts; a text that several parts share is printed once."""
    parts = sorted(parts)
    users: dict[str, list[str]] = {}
    lines = ["Carina contains the following libraries of other authors. Their licence texts follow.", ""]
    for part in parts:
        lines.append(f"  {part.name} {part.version} ({part.kind}): {part.licence}")
        for text in licence_texts(part.folder) if part.folder is not None else ():
            users.setdefault(text, []).append(f"{part.name} {part.version}")
    for text, names in users.items():
        lines += ["", "=" * 80, ", ".join(names), "=" * 80, "", text]
    return "\n".join(lines) + "\n"


def parts_list(version: str, parts: Iterable[Part]) -> dict[str, Any]:
    """Return the list of parts as a CycloneDX document; the same parts give the same document."""
    product = {
        "type": "application", "bom-ref": f"pkg:pypi/carina@{version}", "name": "carina", "version": version,
        "licenses": [{"expression": "Apache-2.0"}],
    }  # fmt: skip
    components = [part.to_cyclonedx() for part in sorted(parts)]
    return {
        "bomFormat": "CycloneDX",
        "specVersion": "1.6",
        "version": 1,
        "metadata": {"component": product},
        "components": components,
        "dependencies": [{"ref": product["bom-ref"], "dependsOn": [one["bom-ref"] for one in components]}],
    }


def schema_problem(document: str) -> str | None:
    """Return the first violation of the CycloneDX 1.6 schema by a software bill of materials; None if it is valid.

    The schema is part of cyclonedx-python-lib, which only the environment of ``make wheels`` has.
    """
    from cyclonedx.schema import SchemaVersion
    from cyclonedx.validation.json import JsonStrictValidator

    found = JsonStrictValidator(SchemaVersion.V1_6).validate_str(document)
    return None if found is None else str(found)


def checksums(files: Iterable[Path]) -> str:
    """Return the SHA-256 digests of files in the format of ``sha256sum``."""
    return "".join(f"{hashlib.sha256(file.read_bytes()).hexdigest()}  {file.name}\n" for file in sorted(files))


def main() -> int:
    """Write the licences, or the list of parts and the checksums of all files of the release in ``dist``."""
    if sys.argv[1:] not in (["licences"], ["sums"]):
        print("expected: licences or sums", file=sys.stderr)
        return 2
    inside = rust_parts() + web_parts()
    if sys.argv[1] == "licences":
        LICENCES.parent.mkdir(exist_ok=True)
        LICENCES.write_text(licence_document(inside), encoding="utf-8")
        return 0
    version = set_version.current()
    document = OUT / f"carina-{version}.cdx.json"
    text = json.dumps(parts_list(version, inside + python_parts()), indent=1) + "\n"
    problem = schema_problem(text)
    if problem is not None:
        print(f"the list of parts is not valid CycloneDX 1.6: {problem}", file=sys.stderr)
        return 1
    document.write_text(text, encoding="utf-8")
    files = [*OUT.glob(f"carina-{version}-*"), document]
    (OUT / "SHA256SUMS").write_text(checksums(files), encoding="utf-8")
    print(f"{document.relative_to(ROOT)} and dist/SHA256SUMS: {len(files)} files")
    return 0


if __name__ == "__main__":
    sys.exit(main())
