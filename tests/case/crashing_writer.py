"""Process that writes to a case file until ``test_crashes.py`` kills it.

For each input line with a seed and a path, the process forks a child, which prints its process ID, and a line before
and after each save.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

import numpy as np

NUM_ACTS = 400
ACTS = ("key", "look", "gaze", "rename", "undo", "redo", "key", "look")


def acts_of(seed):
    """Yield the names of random actions, each with a random number generator; equal seeds yield equal actions."""
    rng = np.random.default_rng(seed)
    while True:
        yield ACTS[rng.integers(len(ACTS))], lambda n: int(rng.integers(n))


def work(seed: int, path: Path, volume, report) -> None:
    from edit_case import EditCase
    from sample_case import ActiveCase, act

    from carina.case import CaseFile

    with CaseFile.open(path) as file:
        moment = file.load(volume)
        active_case = ActiveCase.of(moment, EditCase(volume, moment.first.airways, [], np.zeros(3), np.zeros(3)))
        acts = acts_of(seed)
        for done in range(1, NUM_ACTS):
            name, number = next(acts)
            act(active_case, name, number)
            active_case.numbers["acts"] = done
            report(f"saving {done}")
            file.save(active_case.moment())
            report(f"saved {done}")
            if done % 25 == 0:
                file.write_copy(path.with_name("named.carina"))


def main() -> None:
    folder = Path(sys.argv[1])
    sys.path[:0] = sys.argv[2:]
    import sample_case  # noqa: F401  # before the forks

    from carina.volume import Volume

    volume = Volume(np.load(folder / "ct.npy"), np.load(folder / "lps_from_ijk.npy"))
    for line in sys.stdin:
        seed, _, path = line.strip().partition(" ")
        child = os.fork()
        if child == 0:
            out = os.dup(1)

            def report(text: str, out: int = out) -> None:
                os.write(out, f"{text}\n".encode())

            report(f"pid {os.getpid()}")
            try:
                work(int(seed), Path(path), volume, report)
            except BaseException as error:  # the test must receive any exception
                report(f"failed {type(error).__name__} {error}")
            os._exit(0)
        os.waitpid(child, 0)
        print("gone", flush=True)


if __name__ == "__main__":
    main()
