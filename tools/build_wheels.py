"""Build the wheels that users install: Linux on x86-64 and on 64-bit ARM, for glibc 2.17 and newer.

The web UI is built first, then the licence texts of all parts are collected (``tools/release_documents.py``). Zig links
against the old glibc, so the wheels run on every common distribution. The compiled module uses Python's stable ABI: one
wheel serves Python 3.11 and newer.

Rust needs its standard library for each target: ``rustup target add aarch64-unknown-linux-gnu``. Where rustup cannot
download it, ``tools/unpack_debian_rust.sh`` unpacks Debian's rustc for both targets into ``build/rust``; a compiler in
that folder is preferred. cargo is the installed one.

Run: ``python tools/build_wheels.py`` (part of ``make wheels``).
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
OUT = ROOT / "dist"
RUST = ROOT / "build" / "rust" / "usr"
"""Folder into which ``unpack_debian_rust.sh`` unpacks rustc."""
GLIBC = "manylinux_2_17"
TARGETS = {"x86_64": "x86_64-unknown-linux-gnu", "aarch64": "aarch64-unknown-linux-gnu"}
"""Rust target by the processor's name in the file name of a wheel."""


def rust_environment(environment: dict[str, str]) -> dict[str, str]:
    """Return the environment for cargo: with the compiler of ``build/rust`` if it has been unpacked."""
    found = dict(environment)
    if (RUST / "bin" / "rustc").is_file():
        found["RUSTC"] = str(RUST / "bin" / "rustc")
        libraries = RUST / "lib" / "x86_64-linux-gnu"
        found["LD_LIBRARY_PATH"] = ":".join(filter(None, (str(libraries), found.get("LD_LIBRARY_PATH", ""))))
        # The dependencies of two compilers in one folder would replace each other.
        found.setdefault("CARGO_TARGET_DIR", str(ROOT / "target" / "debian-rust"))
    return found


def missing_target(target: str, environment: dict[str, str]) -> str | None:
    """Return the reason why the compiler cannot build for a target, with the remedy; None if it can."""
    libdir = [environment.get("RUSTC", "rustc"), "--print", "target-libdir", "--target", target]
    ended = subprocess.run(libdir, env=environment, capture_output=True, text=True, check=False)
    if ended.returncode == 0 and any(Path(ended.stdout.strip()).glob("libstd-*.rlib")):
        return None
    return (
        f"Rust has no standard library for {target}; run: rustup target add {target}\n"
        "or, on Debian, where rustup cannot download it: tools/unpack_debian_rust.sh"
    )


def build(target: str, environment: dict[str, str]) -> None:
    """Build the wheel for one target with the GPU renderer, as ``make wheel`` does."""
    command = [sys.executable, "-m", "maturin", "build", "--release", "--locked", "--zig", "--target", target]
    command += ["--compatibility", GLIBC, "--features", "extension-module,gpu", "--out", str(OUT)]
    subprocess.run(command, cwd=ROOT, env=environment, check=True)


def main() -> int:
    """Build the web UI, then one wheel for each processor; print the time and the size of each wheel."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("processors", nargs="*", metavar="PROCESSOR", help=f"default: {' '.join(TARGETS)}")
    chosen = parser.parse_args().processors or list(TARGETS)
    unknown = [name for name in chosen if name not in TARGETS]
    if unknown:
        parser.error(f"no such processor: {' '.join(unknown)}; expected {' or '.join(TARGETS)}")
    # maturin and zig are programs of the environment that runs this script.
    path = os.pathsep.join((str(Path(sys.executable).parent), os.environ.get("PATH", "")))
    environment = rust_environment({**os.environ, "PATH": path})
    problems = [why for name in chosen if (why := missing_target(TARGETS[name], environment)) is not None]
    if problems:
        print("\n".join(problems), file=sys.stderr)
        return 1
    began = time.monotonic()
    sys.path.insert(0, str(ROOT / "build_backend"))
    from carina_backend import build_web  # needs maturin, which only this recipe's environment has

    build_web()
    print(f"web UI: {time.monotonic() - began:.0f} s", flush=True)
    documents = [sys.executable, str(ROOT / "tools" / "release_documents.py")]
    subprocess.run([*documents, "licences"], check=True)
    for name in chosen:
        for old in OUT.glob(f"carina-*{name}.whl"):
            old.unlink()
        began = time.monotonic()
        build(TARGETS[name], environment)
        [wheel] = OUT.glob(f"carina-*{name}.whl")
        seconds = time.monotonic() - began
        print(f"{wheel.relative_to(ROOT)}: {wheel.stat().st_size / 1e6:.1f} MB, {seconds:.0f} s", flush=True)
    subprocess.run([*documents, "sums"], check=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
