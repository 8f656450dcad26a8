"""Tests of a process whose memory is limited: a message and exit code 1, no abort."""

from __future__ import annotations

import subprocess
import sys

import pytest

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="the limit of the address space is a limit of Linux")

PROGRAM = """
import resource
import carina
carina.generate_phantom(spacing_mm=4.0, generations=3)
pages = int(open("/proc/self/statm").read().split()[0])
limit = pages * resource.getpagesize() + (100 << 20)
resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
carina.generate_phantom(spacing_mm=0.5, generations=3)
"""
"""Program that allocates several hundred megabytes although it may use only 100 more."""


def test_compiled_code_without_memory_ends_with_a_message_and_exit_code_1():
    ended = subprocess.run([sys.executable, "-c", PROGRAM], capture_output=True, text=True, check=False, timeout=600)
    assert ended.returncode == 1, ended.stderr
    assert ended.stderr == "carina: not enough memory; close other programs, or use a smaller volume or image\n"
