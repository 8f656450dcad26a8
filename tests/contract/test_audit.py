"""Tests of the audit of dependencies: licences, advisories, and checks that could not run.

Each finding fails the audit unless it is accepted until a date.
"""

from __future__ import annotations

import datetime
import importlib.util
import json
import subprocess
import sys
from email.message import Message
from importlib import metadata
from pathlib import Path
from types import SimpleNamespace

import pytest

ROOT = Path(__file__).resolve().parents[2]
TODAY = datetime.date(2026, 6, 1)


@pytest.fixture(scope="module")
def audit():
    spec = importlib.util.spec_from_file_location("audit", ROOT / "tools" / "audit.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules["audit"] = module  # dataclasses look up their module there
    spec.loader.exec_module(module)
    yield module
    del sys.modules["audit"]


@pytest.fixture
def allowed(audit):
    return audit.Allowed(frozenset({"MIT", "Apache-2.0", "Apache-2.0 WITH LLVM-exception", "Unicode-3.0"}), {}, {})


EXPRESSIONS = [
    ("MIT", True),
    ("mit", True),
    ("GPL-3.0-only", False),
    ("MIT OR GPL-3.0-only", True),
    ("GPL-3.0-only OR MIT", True),
    ("MIT AND GPL-3.0-only", False),
    ("MIT/Apache-2.0", True),
    ("(MIT OR Apache-2.0) AND Unicode-3.0", True),
    ("(MIT OR Apache-2.0) AND GPL-2.0", False),
    ("MIT OR GPL-2.0 AND GPL-3.0", True),
    ("Apache-2.0 WITH LLVM-exception", True),
    ("Apache-2.0 WITH Other-exception", False),
    ("MIT OR Apache-2.0 OR LGPL-2.1-or-later", True),
    ("SEE LICENSE IN file", False),
    ("", False),
    ("MIT MIT", False),
    ("(MIT", False),
    ("MIT)", False),
    ("AND", False),
    ("MIT OR", False),
]


@pytest.mark.parametrize(("expression", "good"), EXPRESSIONS)
def test_licence_expression_is_compared_with_the_allowed_licences(audit, allowed, expression, good):
    assert audit.licence_allowed(expression, allowed.licences) is good


def test_repository_has_only_allowed_licences(audit):
    own = audit.read_allowed(ROOT / "tools" / "audit.toml")
    for result in (audit.npm_licences(ROOT, own), audit.python_licences(ROOT, own), audit.rust_licences(ROOT, own)):
        assert result.bad == []
        assert result.num_seen > 10, result


def test_package_without_a_licence_is_a_finding_until_it_is_reviewed(audit, allowed, tmp_path):
    (tmp_path / "web").mkdir()
    lock = {"packages": {"": {}, "node_modules/a": {"license": "MIT"}, "node_modules/b": {}, "node_modules/x/c": {}}}
    (tmp_path / "web" / "package-lock.json").write_text(json.dumps(lock), encoding="utf-8")
    found = audit.npm_licences(tmp_path, allowed)
    assert [text.split()[0] for text in found.bad] == ["b", "x/c"]
    known = audit.Allowed(allowed.licences, {"b": "MIT", "x/c": "MIT"}, {})
    assert audit.npm_licences(tmp_path, known).lines() == ["licences, npm: 3 looked at, all good"]


def test_python_licence_is_read_from_expression_classifier_or_text(audit, allowed, tmp_path):
    (tmp_path / "requirements.lock").write_text("a==1 \\\n  --hash=x\nb[x]==2\nc==3\nd==4\n", encoding="utf-8")
    (tmp_path / "requirements-cluster.lock").write_text("gone==5 ; sys_platform == 'x'\n", encoding="utf-8")

    def about(name):
        message = Message()
        match name:
            case "a":
                message["License-Expression"] = "MIT"
            case "b":
                message["Classifier"] = "License :: OSI Approved :: Apache Software License"
            case "c":
                message["License"] = "MIT License\nCopyright"
            case "d":
                message["Classifier"] = "License :: Other/Proprietary License"
            case _:
                raise metadata.PackageNotFoundError(name)
        return message

    found = audit.python_licences(tmp_path, allowed, about)
    assert found.num_seen == 4
    assert [text.split()[0] for text in found.bad] == ["d"]
    assert "1 packages that are not installed here (gone)" in found.unseen[0]


def answers(text, *, error="", code=0):
    return lambda *_command, **_options: SimpleNamespace(stdout=text, stderr=error, returncode=code)


def test_check_without_a_tool_network_or_answer_is_reported_as_a_gap(audit, allowed, monkeypatch):
    def silent(*command, **_options):
        raise subprocess.TimeoutExpired(command, 1)

    looks = (audit.rust_advisories, audit.python_advisories, audit.npm_advisories)
    monkeypatch.setattr(audit.shutil, "which", lambda _tool: None)
    assert ["is not installed" in look(ROOT, allowed, TODAY).lines()[0] for look in looks] == [True] * 3
    monkeypatch.setattr(audit.shutil, "which", lambda tool: tool)
    for run in (silent, answers(""), answers("<html>", error="no route"), answers("{}")):
        for look in looks:
            result = look(ROOT, allowed, TODAY, run)
            assert (result.bad, result.num_seen) == ([], 0)
            assert len(result.unseen) == 1
            assert "NOT looked at" in "\n".join(result.lines())
            assert "good" not in "\n".join(result.lines())


def test_package_skipped_by_pip_audit_is_reported_as_a_gap(audit, allowed, monkeypatch):
    monkeypatch.setattr(audit.shutil, "which", lambda tool: tool)
    rows = [{"name": "a", "skip_reason": "not found"}, {"name": "b", "vulns": []}]
    result = audit.python_advisories(ROOT, allowed, TODAY, answers(json.dumps({"dependencies": rows})))
    assert result.unseen == ["pip-audit could not look up 1 of 2 packages"]
    assert result.num_seen == 1


REPORTS = {
    "rust_advisories": {
        "database": {"advisory-count": 700},
        "lockfile": {"dependency-count": 60},
        "vulnerabilities": {
            "list": [{"advisory": {"id": "RUSTSEC-2026-0001", "title": "bad"}, "package": {"name": "time"}}]
        },
    },
    "python_advisories": {
        "dependencies": [{"name": "h11", "vulns": [{"id": "GHSA-aaaa-bbbb-cccc", "fix_versions": ["1"]}]}]
    },
    "npm_advisories": {
        "metadata": {"dependencies": {"total": 160}},
        "vulnerabilities": {
            "vite": {"via": [{"url": "https://github.com/advisories/GHSA-dddd-eeee-ffff", "title": "bad"}]},
            "vitest": {"via": ["vite"]},
        },
    },
}


@pytest.mark.parametrize("look", REPORTS)
def test_advisory_is_a_finding_unless_a_valid_exception_names_it(audit, allowed, monkeypatch, look):
    monkeypatch.setattr(audit.shutil, "which", lambda tool: tool)
    run = answers(json.dumps(REPORTS[look]), code=1)
    look_up = getattr(audit, look)
    [bad] = look_up(ROOT, allowed, TODAY, run).bad
    number = bad.split()[0]
    excepted = audit.Allowed(allowed.licences, {}, {number.upper(): TODAY})
    assert look_up(ROOT, excepted, TODAY, run).bad == []
    [ended] = look_up(ROOT, excepted, TODAY + datetime.timedelta(days=1), run).bad
    assert "ended on 2026-06-01" in ended


def test_exception_without_a_reason_or_an_end_date_is_refused(audit, tmp_path):
    path = tmp_path / "audit.toml"
    for text in (
        '[[advisories]]\nid = "X"\nuntil = 2026-01-01\n',
        '[[advisories]]\nid = "X"\nreason = "y"\n',
        '[[licences.known]]\npackage = "x"\nlicence = "MIT"\n',
        '[[gaps]]\ncheck = "advisories, npm"\nuntil = 2026-01-01\n',
        '[[gaps]]\ncheck = "advisories, npm"\nreason = "y"\n',
    ):
        path.write_text(text, encoding="utf-8")
        with pytest.raises(SystemExit, match="needs a reason"):
            audit.read_allowed(path)


def test_accepted_gap_of_an_unknown_check_is_refused(audit, tmp_path):
    path = tmp_path / "audit.toml"
    path.write_text('[[gaps]]\ncheck = "advisories"\nreason = "y"\nuntil = 2026-01-01\n', encoding="utf-8")
    with pytest.raises(SystemExit, match="is no check"):
        audit.read_allowed(path)


def audit_without_tools(audit, allowed, monkeypatch, *, gap_until=None) -> int:
    """Run the audit without readable databases; accept the gaps until a date if one is given."""
    gaps = {} if gap_until is None else {name: audit.Gap("closed network", gap_until) for name in audit.CHECKS}
    monkeypatch.setattr(audit, "read_allowed", lambda _path: audit.Allowed(allowed.licences, {}, {}, gaps))
    for check in audit.CHECKS:
        name = "_".join(reversed(check.lower().split(", ")))
        result = audit.Result(check, unseen=["no tool"] if check.startswith("advisories") else [])
        monkeypatch.setattr(audit, name, lambda *_arguments, result=result: result)
    return audit.main()


def test_audit_without_a_readable_advisory_database_fails(audit, allowed, monkeypatch, capsys):
    assert audit_without_tools(audit, allowed, monkeypatch) == 1
    assert capsys.readouterr().out.count("NOT looked at: no tool; make the check possible, or accept the gap") == 3


def test_accepted_gap_passes_until_its_last_day_and_is_printed_with_its_reason(audit, allowed, monkeypatch, capsys):
    today = datetime.datetime.now(tz=datetime.UTC).date()
    assert audit_without_tools(audit, allowed, monkeypatch, gap_until=today) == 0
    assert capsys.readouterr().out.count(f"accepted until {today}: no tool (closed network)") == 3
    yesterday = today - datetime.timedelta(days=1)
    assert audit_without_tools(audit, allowed, monkeypatch, gap_until=yesterday) == 1
    assert capsys.readouterr().out.count(f"audit.toml accepted this gap until {yesterday}") == 3


def test_audit_with_an_accepted_gap_is_not_reported_as_complete(audit, allowed):
    result = audit.Result("licences, Python", num_seen=3, unseen=["1 package"])
    gap = audit.Gap("another system", TODAY)
    audit.judge_gaps([result], audit.Allowed(allowed.licences, {}, {}, {"licences, Python": gap}), TODAY)
    assert result.lines()[-1] == "licences, Python: 3 looked at, these good"
