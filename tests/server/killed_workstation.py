"""Process from which workstations are forked and killed, started by ``forked_workstations.py``.

For each line with the path of a CT the process forks a child that serves the CT as ``carina open`` does, and prints
process ID, URL and token. The imports, which take a second, run only once. An argument gives the seconds after which a
disk counts as silent and is tried again.
"""

from __future__ import annotations

import os
import sys


def work(path: str, out: int) -> None:
    from carina.server import serve

    def report(text: str) -> None:
        os.write(out, f"{text}\n".encode())

    report(f"pid {os.getpid()}")
    serve(path, open_browser=False, on_ready=lambda url, token: report(f"url {url} {token}"))


def main() -> None:
    import carina.render
    import carina.server.serve
    import carina.track
    import carina.volume.opening  # noqa: F401  # before the forks

    if len(sys.argv) > 1:
        from carina.session.saving import writer

        writer.SLOW_S = writer.RETRY_S = float(sys.argv[1])
    for line in sys.stdin:
        child = os.fork()
        if child == 0:
            out = os.dup(1)
            null = os.open(os.devnull, os.O_RDWR)
            os.dup2(null, 0)
            try:
                work(line.strip(), out)
            finally:
                os._exit(0)
        os.waitpid(child, 0)
        print("gone", flush=True)


if __name__ == "__main__":
    main()
