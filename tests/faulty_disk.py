"""Disk that stalls, fails or loses power on request of a test: the preloaded library ``faulty_disk.c``."""

from __future__ import annotations

import ctypes
import errno
import mmap
import random
import shutil
import struct
import subprocess
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

HERE = Path(__file__).parent
STALL = -1
FAULTS = {"stall": STALL, "full": errno.ENOSPC, "error": errno.EIO, "read-only": errno.EROFS}
NEVER = -1


class _Control(ctypes.Structure):
    _fields_ = (
        ("count", ctypes.c_int64),
        ("at", ctypes.c_int64),
        ("fault", ctypes.c_int32),
        ("active", ctypes.c_int32),
        ("waiting", ctypes.c_int32),
        ("logs", ctypes.c_int32),
        ("folder", ctypes.c_char * 1024),
        ("log", ctypes.c_char * 1024),
    )


def has_compiler() -> bool:
    return shutil.which("cc") is not None


class FaultyDisk:
    """Faults of the file operations below a folder, in all processes that were started with :attr:`environment`.

    Parameters
    ----------
    folder
        Temporary folder of the test, in which the library is compiled.
    """

    def __init__(self, folder: Path) -> None:
        library, page = folder / "faulty_disk.so", folder / "faulty_disk.page"
        subprocess.run(
            [
                "cc",
                "-shared",
                "-fPIC",
                "-O1",
                "-Wall",
                "-Werror",
                "-o",
                library,
                HERE / "faulty_disk.c",
                "-ldl",
                "-lpthread",
            ],
            check=True,
        )
        page.write_bytes(bytes(ctypes.sizeof(_Control)))
        with page.open("r+b") as file:
            self._memory = mmap.mmap(file.fileno(), 0)
        self._control = _Control.from_buffer(self._memory)
        self._control.at = NEVER
        self._log = folder / "faulty_disk.log"
        self._control.log = str(self._log).encode()
        self.environment = {"LD_PRELOAD": str(library), "CARINA_FAULTY_DISK": str(page)}

    def begin(self, fault: int, after: int, folder: Path) -> None:
        """Start a fault at a future change of a file below ``folder``.

        Parameters
        ----------
        fault
            An errno, or the value that stalls.
        after
            Number of the change, counted from now, at which the fault begins.
        folder
            Folder whose changes are counted and fail.
        """
        self.heal()
        self._control.folder = str(folder).encode()
        self._control.fault = fault
        self._control.waiting = 0  # A killed process may have left a count above 0.
        self._control.at = self._control.count + after

    def heal(self) -> None:
        """End the fault, and let stalled operations continue."""
        self._control.at = NEVER
        self._control.active = 0

    @property
    def is_faulty(self) -> bool:
        """Whether the fault of the disk has begun."""
        return bool(self._control.active)

    @property
    def is_stalled(self) -> bool:
        """Whether a thread is waiting for the disk."""
        return self._control.waiting > 0

    @property
    def count(self) -> int:
        """Number of changes of files since the start."""
        return int(self._control.count)

    def record(self, folder: Path) -> Durable:
        """Record all changes below a folder from now on; its present content counts as written to the disk."""
        self._log.write_bytes(b"")
        self._control.folder = str(folder).encode()
        self._control.logs = 1
        return Durable.of(folder, self._log)

    def end_record(self) -> None:
        self._control.logs = 0


@dataclass
class _File:
    synced: bytes = b""
    content: bytearray = field(default_factory=bytearray)
    since: list[tuple[int, bytes]] = field(default_factory=list)
    """Writes (offset, data) and truncations (-1 - new length, no data) of the file since its last fsync."""


class Durable:
    """Content of a folder that survives a power cut.

    The content of a file survives if the file was synchronised with ``fsync``, its name if its folder was.
    """

    def __init__(self, folder: Path, log: Path) -> None:
        self._folder, self._log = folder, log
        self._names: dict[str, _File | None] = {}
        """Files by path, as programs see them; None is a folder."""
        self._before: dict[str, _File | None] = {}
        self._moves: list[tuple[bool, list[tuple[str, _File | bool | None]]]] = []
        """Changes of names in order: whether the change is on the disk, and its new entries.

        False is a deleted name.
        """

    @classmethod
    def of(cls, folder: Path, log: Path) -> Durable:
        made = cls(folder, log)
        for path in sorted(folder.rglob("*")):
            content = path.read_bytes() if path.is_file() else None
            made._names[str(path)] = None if content is None else _File(content, bytearray(content))
        made._before = dict(made._names)
        return made

    def read(self) -> None:
        """Read the log of the library, and apply the recorded changes of files."""
        for op, path, other, offset, data in _entries(self._log.read_bytes()):
            if path.endswith("-shm"):
                continue  # The file is shared memory, which SQLite creates again.
            self._do(op, path, other, offset, data)

    def _do(self, op: int, path: str, other: str, offset: int, data: bytes) -> None:
        file = self._names.get(path)
        if op in {1, 2}:
            assert file is not None, path
            file.since.append((offset, data) if op == 1 else (-1 - offset, b""))
            _apply(file.content, file.since[-1])
        elif op == 3 and file is not None:
            file.synced, file.since = bytes(file.content), []
        elif op == 3:
            self._moves = [
                (done or all(str(Path(name).parent) == path for name, _ in move), move) for done, move in self._moves
            ]
        elif op == 4:
            below = [name for name in self._names if name == path or name.startswith(path + "/")]
            self._change(
                [(other + name[len(path) :], self._names[name]) for name in below] + [(name, False) for name in below]
            )
        elif op in {5, 8}:
            self._change([(path, False)])
        elif op == 9:
            self._change([(other, self._names[path])])
        else:
            self._change([(path, _File() if op == 6 else None)])

    def _change(self, move: list[tuple[str, _File | bool | None]]) -> None:
        _stand(self._names, move)
        self._moves.append((False, move))

    def restore(self, rng: random.Random | None = None) -> None:
        """Restore the folder to a state that it may have after the power cut.

        Without ``rng`` every change that was not synchronised is lost; with ``rng`` a random part of these changes
        survives.
        """
        names = dict(self._before)
        reached = 0 if rng is None else rng.randint(0, len(self._moves))
        for n, (done, move) in enumerate(self._moves):
            if done or n < reached:
                _stand(names, move)
        shutil.rmtree(self._folder)
        self._folder.mkdir()
        for name, file in sorted(names.items(), key=lambda item: item[0]):
            if file is None:
                Path(name).mkdir(parents=True, exist_ok=True)
        for name, file in names.items():
            if isinstance(file, _File) and Path(name).parent.is_dir():
                content = bytearray(file.synced)
                for change in file.since if rng is not None else ():
                    if rng is not None and rng.random() < 0.5:
                        _apply(content, change)
                Path(name).write_bytes(content)
                Path(name).chmod(0o600)


def _stand(names: dict[str, _File | None], move: list[tuple[str, _File | bool | None]]) -> None:
    for name, file in move:
        if isinstance(file, bool):
            names.pop(name, None)
        else:
            names[name] = file


def _apply(content: bytearray, change: tuple[int, bytes]) -> None:
    offset, data = change
    length = -1 - offset if offset < 0 else offset
    if len(content) < length:
        content.extend(bytes(length - len(content)))
    if offset < 0:
        del content[length:]
    else:
        content[offset : offset + len(data)] = data


def _entries(log: bytes) -> Iterator[tuple[int, str, str, int, bytes]]:
    head = struct.Struct("=3I2Q")
    place = 0
    while place + 28 <= len(log):
        op, length, other, offset, size = head.unpack_from(log, place)
        place += head.size
        end = place + length + other + size
        if end > len(log):
            return  # The process ended while it wrote this entry.
        texts = log[place : place + length + other].decode()
        yield op, texts[:length], texts[length:], offset, log[end - size : end]
        place = end
