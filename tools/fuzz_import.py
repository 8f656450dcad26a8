"""Coverage-guided fuzzing of header logic and archives of the import, by atheris; ``make fuzz`` runs it.

The corpus of each target is stored in ``tests/volume/fuzz_corpus/NAME.zip``. A run unpacks it to ``target/fuzz``,
starts from it and from the generated inputs of ``tests/volume/corpus.py``, and stops after a number of seconds. An
input that ends with an error other than one of Carina is a finding; it is written to ``target/fuzz/findings``.
``--store`` replaces the stored corpus by the smallest set of inputs with the same coverage.
"""

from __future__ import annotations

import argparse
import hashlib
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Iterable
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
TESTS = ROOT / "tests" / "volume"
STORED = TESTS / "fuzz_corpus"
WORK = ROOT / "target" / "fuzz"
MAX_BYTES = 20_000
TARGETS = ("grids", "dicom", "archives")
DICOM_EVERY = 8
"""Ratio of all DICOM inputs to generated ones, whose slices differ in several tags."""


def unpack(target: str, folder: Path, more: Iterable[bytes]) -> None:
    """Write the stored corpus of a target and more inputs into a folder, one file for each input."""
    folder.mkdir(parents=True, exist_ok=True)
    path = STORED / f"{target}.zip"
    if path.exists():
        with zipfile.ZipFile(path) as archive:
            for name in archive.namelist():
                (folder / name).write_bytes(archive.read(name))
    for data in more:
        if len(data) <= MAX_BYTES:
            (folder / hashlib.sha1(data, usedforsecurity=False).hexdigest()).write_bytes(data)


def generated() -> dict[str, list[bytes]]:
    """Return one file of each generated input for each target; of DICOM folders of one slice each only some."""
    from corpus import all_inputs

    found: dict[str, list[bytes]] = {target: [] for target in TARGETS}
    for number, entry in enumerate(all_inputs()):
        if entry.family.startswith("DICOM") and "enhanced" not in entry.family and number % DICOM_EVERY:
            continue
        with tempfile.TemporaryDirectory() as scratch:
            path = entry.make(Path(scratch))
            files = [path] if path.is_file() else sorted(p for p in path.rglob("*") if p.is_file())[:1]
            for data in (file.read_bytes() for file in files):
                is_archive = data.startswith((b"PK", b"7z", b"\xfd7zXZ")) or ".tar" in path.name
                found["dicom" if data[128:132] == b"DICM" else "archives" if is_archive else "grids"].append(data)
    return found


def store(target: str, folder: Path) -> None:
    """Replace the stored corpus by the smallest part of a folder that has the same coverage."""
    with tempfile.TemporaryDirectory() as scratch:
        command = [sys.executable, __file__, "--run", target, "--", "-merge=1", scratch, str(folder)]
        subprocess.run(command, check=True)
        STORED.mkdir(exist_ok=True)
        with zipfile.ZipFile(STORED / f"{target}.zip", "w", zipfile.ZIP_LZMA) as archive:
            for path in sorted(Path(scratch).iterdir()):
                archive.writestr(zipfile.ZipInfo(path.name), path.read_bytes(), zipfile.ZIP_LZMA)


def run(target: str, options: list[str]) -> None:
    """Start libFuzzer in this process; the process ends with it."""
    import atheris

    with atheris.instrument_imports(include=["carina.volume"]):
        import fuzz_targets

    def one(data: bytes) -> None:
        fuzz_targets.once(target, data)

    atheris.Setup([sys.argv[0], *options], one)
    atheris.Fuzz()


def main() -> int:
    """Fuzz each target for a part of the time; return 1 after a finding."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=int, default=60, help="for each target")
    parser.add_argument("--only", choices=TARGETS, action="append")
    parser.add_argument("--store", action="store_true", help="replace the stored corpus")
    parser.add_argument("--run", choices=TARGETS, help=argparse.SUPPRESS)
    parser.add_argument("options", nargs="*", help=argparse.SUPPRESS)
    given = parser.parse_args()
    sys.path[:0] = [str(TESTS), str(TESTS.parent)]
    if given.run:
        run(given.run, given.options)
        return 0
    findings = WORK / "findings"
    findings.mkdir(parents=True, exist_ok=True)
    failed = False
    more = generated()
    for target in given.only or TARGETS:
        folder = WORK / target
        unpack(target, folder, more[target])
        options = [
            *(f"-max_total_time={given.seconds}", "-timeout=25", "-rss_limit_mb=2500", f"-max_len={MAX_BYTES}"),
            *(f"-artifact_prefix={findings}/{target}-", "-print_final_stats=1", str(folder)),
        ]
        ended = subprocess.run([sys.executable, __file__, "--run", target, "--", *options], check=False)
        failed |= ended.returncode != 0
    for target in given.only or TARGETS if given.store else ():
        store(target, WORK / target)
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
