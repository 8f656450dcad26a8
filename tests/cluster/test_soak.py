"""Soak tests of a cluster: a flight of ten minutes with a member killed every 20 s, and a lost head."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path

import pytest
from ray_cluster import VIEW, flying, needs_ray, running_head, wait_for

from carina.cluster import ClusterSettings
from carina.cluster.node import descendants, end_processes
from carina_bench.cluster_sleeping_renderer import SleepingRenderer

SECONDS = float(os.environ.get("CARINA_SOAK_SECONDS", "600"))
KILL_EVERY_S = 20.0


def _resident_bytes() -> int:
    return int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1]) * os.sysconf("SC_PAGE_SIZE")


@pytest.mark.soak
@pytest.mark.ray
@needs_ray
@pytest.mark.filterwarnings("ignore")
def test_frames_continue_for_ten_minutes_while_a_member_is_killed_every_20_seconds():
    with running_head(renderers=4) as head:
        with flying(head, SleepingRenderer, num=4, settings=ClusterSettings(), row_seconds=0.004 / 128) as flight:
            # The list of jobs would grow during the flight and is not used in this test.
            flight.console.jobs = None
            began_s = time.monotonic()
            killed, due, frames, resident, shown_s, gaps, stood_in, theirs = 0, 1, 0, [], time.monotonic(), [], 0, []
            while (now_s := time.monotonic() - began_s) < SECONDS:
                if now_s > due * KILL_EVERY_S:
                    due += 1
                    resident.append(_resident_bytes())
                    head.look()
                    names = flight.ready()
                    if names:
                        os.kill(flight.console.facts(names[killed % len(names)]).pid, signal.SIGKILL)
                        killed += 1
                picture = flight.renderer.render(VIEW)
                gaps.append(time.monotonic() - shown_s)
                shown_s = time.monotonic()
                frames += 1
                stood_in += picture.stats.method == "stand-in"
                theirs.append(flight.check(picture))
                time.sleep(max(0.0, 1 / 30 - (time.monotonic() - began_s - now_s)))
            wait_for(lambda: len(flight.ready()) == 4)
        # The first minutes fill caches; afterwards the memory must not grow.
        settled = resident[len(resident) // 3 :]
        print(f"{frames} frames, {killed} kills, worst gap {max(gaps):.3f} s, resident {resident[0]} to {resident[-1]}")
        print(f"{stood_in} pictures with rows of the renderers, {sum(theirs) / frames:.4f} of all rows")
        assert killed >= SECONDS // KILL_EVERY_S - 1
        assert max(gaps) < 2
        # The console renders strips of dead renderers, but at most a tenth of the flight.
        assert stood_in > 0.9 * frames
        assert sum(theirs) > 0.9 * frames
        assert max(settled) - min(settled) < 50 * 2**20
    assert len(head.seen) > 4 + killed, "the wrong renderers were listed"
    assert head.left == []


@pytest.mark.soak
@pytest.mark.ray
@needs_ray
@pytest.mark.filterwarnings("ignore")
def test_console_renders_alone_after_the_head_node_is_lost():
    """Check that the program continues although Ray by default ends a program 60 s after its head is lost."""
    with running_head(renderers=2) as head, flying(head, SleepingRenderer, num=2, row_seconds=0.004 / 256) as flight:
        assert flight.check(flight.renderer.render(VIEW)) == 1.0
        head.look()
        tree = descendants(head.node.process.pid)
        head.node.process.kill()
        end_processes(tree, grace_s=0.0)
        end_s = time.monotonic() + 75.0
        while time.monotonic() < end_s:
            began_s = time.monotonic()
            flight.check(flight.renderer.render(VIEW))
            assert time.monotonic() - began_s < 10.0
            time.sleep(0.2)
        assert flight.console.status().alone
