"""Tests of Ctrl-C in each long stage of a real process: exit code 130, a message, and no partial files."""

from __future__ import annotations

import json
import signal
import subprocess
import sys

import pytest

from carina.cli.console import interruptible
from user_folders import environment_in

WAIT_S = 120.0
"""Time limit of every wait, seconds.

A picture of these tests takes minutes, so only an interrupted command ends within the limit.
"""


@pytest.mark.parametrize("stage", ["import", "phantom", "picture"])
def test_ctrl_c_exits_with_code_130_and_leaves_no_file(stage, ct, tmp_path):
    output = tmp_path / "x.png"
    command, sign = {
        "import": (["info", ct], None),
        "phantom": (["phantom", "-o", tmp_path / "made", "--spacing-mm", "0.5"], "generating the phantom"),
        "picture": (
            ["render", ct, "--size", "8192x8192", "--method", "brute", "--step-vox", "0.01", "-o", output],
            "airways segmented",
        ),
    }[stage]
    environment = environment_in(tmp_path)
    with subprocess.Popen(
        [sys.executable, "-c", STARTED, *map(str, command), "--json"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=environment,
    ) as process:
        try:
            lines = iter(process.stderr.readline, "")
            assert any((sign or "started") in line for line in lines)
            process.send_signal(signal.SIGINT)
            out, err = process.communicate(timeout=WAIT_S)
        finally:
            process.kill()
    assert process.returncode == 130, err
    assert err.strip().splitlines()[-1] == "stopped"
    if stage != "import":
        assert json.loads(out)["error"]["code"] == "cancelled"
    assert not output.exists()
    assert not (tmp_path / "made").exists()
    assert not list(tmp_path.glob("*.png"))


# Program that restores the handling of Ctrl-C: a shell that starts the tests in the background makes its children
# ignore it, unlike a terminal.
STARTED = """
import signal
import sys

signal.signal(signal.SIGINT, signal.default_int_handler)

from carina.cli import main

class Sign:
    # Report that main() has begun and is loading its libraries.
    def find_spec(self, name, path=None, target=None):
        if name == "carina.cli.app":
            print("started", file=sys.stderr, flush=True)

sys.meta_path.insert(0, Sign())
main()
"""


def test_interruptible_function_returns_its_result_or_raises_its_error():
    assert interruptible(lambda: 7) == 7
    with pytest.raises(ZeroDivisionError):
        interruptible(lambda: 1 // 0)
