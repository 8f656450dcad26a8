"""Number of threads that render pictures, and the reservation of one thread for other work."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from carina import _core


def picture_threads() -> int:
    """Return the number of threads that render a picture; `reserved_thread` reduces the number by one.

    Examples
    --------
    >>> picture_threads() >= 1
    True
    """
    return _core.picture_threads()


@contextmanager
def reserved_thread() -> Iterator[None]:
    """Reserve one thread, inside this ``with`` block, for work with deadlines such as a force loop.

    Pictures keep at least one thread. Nested contexts reserve only one thread together.

    Examples
    --------
    >>> threads = picture_threads()
    >>> with reserved_thread():
    ...     picture_threads() == max(1, threads - 1)
    True
    """
    thread = _core.ReservedThread()
    try:
        yield
    finally:
        thread.release()
