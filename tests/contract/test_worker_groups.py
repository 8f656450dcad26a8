"""Tests of the distribution of tests to workers: a file has one worker and keeps its order; all Ray tests share one."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
FILES = ("tests/scopes/test_pose.py", "tests/scopes/test_lens.py", "tests/scopes/test_library.py")


@pytest.mark.slow
def test_tests_of_one_file_run_in_one_worker_in_their_order():
    pytest.importorskip("xdist")
    command = [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", "-v", "-n", "2"]
    dist = re.search(r"--dist .*?(?= -ra)", (ROOT / "Makefile").read_text(encoding="utf-8"))
    assert dist is not None
    done = subprocess.run(
        [*command, *dist.group().split(), *FILES], cwd=ROOT, capture_output=True, text=True, timeout=300, check=False
    )
    ran = re.findall(r"^\[(gw\d)\].*PASSED (tests/\S+?)::(\w+)", done.stdout, flags=re.MULTILINE)
    assert len(ran) > 20, done.stdout + done.stderr
    for file in FILES:
        assert len({worker for worker, path, _ in ran if path == file}) == 1
        names = list(dict.fromkeys(name for _, path, name in ran if path == file))
        text = (ROOT / file).read_text(encoding="utf-8")
        assert names == sorted(names, key=lambda name: text.index(f"def {name}("))


@pytest.mark.parametrize(
    ("group", "text", "least"),
    [("ray", "mark." + "ray", 3), ("planned chest", "phantom" + "_plan", 10), ("shared chest", "shared" + "_chest", 4)],
)
def test_all_test_files_with_common_results_are_in_one_group(group: str, text: str, least: int) -> None:
    from conftest import group_of

    uses = [path for path in (ROOT / "tests").rglob("test_*.py") if text in path.read_text(encoding="utf-8")]
    paths = {path.relative_to(ROOT).as_posix() for path in uses}
    assert len(paths) >= least
    assert {group_of(path) for path in paths} == {group}
    assert group_of(FILES[0]) == FILES[0]
