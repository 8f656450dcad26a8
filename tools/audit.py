"""Check the licences of all dependencies against an allow list, and search databases for known advisories.

Licences are always read from this machine: Rust by ``cargo metadata``, npm by the lock file, Python from the installed
packages of the lock files. Advisories need ``cargo audit``, ``pip-audit`` and ``npm audit``, and the network.

A check that could not run, or that did not cover all packages, has a gap. The audit fails at a gap, unless
``tools/audit.toml`` accepts it (``[[gaps]]``). That file also lists the accepted advisories. Each entry of the file
needs a reason and a last day; after that day the audit fails.

Run: ``python tools/audit.py`` (part of ``make check``).
"""

from __future__ import annotations

import datetime
import json
import re
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from importlib import metadata
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
WITHIN_S = 15.0
"""Maximum time in s to wait for each database, so that a network that does not answer cannot block the checks."""
LOCKS = ("requirements.lock", "requirements-cluster.lock")
"""Lock files of the Python packages that are checked."""

CHECKS = (
    "licences, Rust",
    "licences, npm",
    "licences, Python",
    "advisories, Rust",
    "advisories, npm",
    "advisories, Python",
)
"""Names of the checks, as ``audit.toml`` uses them."""
TOOLS = {"cargo-audit": "cargo install cargo-audit --locked", "pip-audit": "uv tool install pip-audit"}
"""Command that installs each missing program that reads advisories, by the program's name."""

CLASSIFIERS = {
    "Apache Software License": "Apache-2.0",
    "BSD License": "BSD-3-Clause",
    "ISC License (ISCL)": "ISC",
    "MIT License": "MIT",
    "MIT No Attribution License (MIT-0)": "MIT-0",
    "Mozilla Public License 2.0 (MPL 2.0)": "MPL-2.0",
    "Python Software Foundation License": "PSF-2.0",
    "The Unlicense (Unlicense)": "Unlicense",
    "zlib/libpng License": "Zlib",
}
"""SPDX expression by the licence classifier of a Python package."""


@dataclass(slots=True)
class Result:
    """Result of one check of :data:`CHECKS`."""

    what: str
    num_seen: int = 0
    bad: list[str] = field(default_factory=list)
    unseen: list[str] = field(default_factory=list)
    """Reasons, one line each, why the check could not run or did not cover all packages."""
    accepted: list[str] = field(default_factory=list)
    """Gaps that ``audit.toml`` accepts: description, last day and reason, one line each."""

    def lines(self) -> list[str]:
        """Return the lines to print about a check: failures, gaps, accepted gaps, and number of packages."""
        reported = [f"{self.what}: {words}" for words in self.bad]
        reported += [f"{self.what}: NOT looked at: {words}" for words in self.unseen]
        reported += [f"{self.what}: NOT looked at, accepted {words}" for words in self.accepted]
        if self.num_seen and not self.bad:
            part = "these" if self.unseen or self.accepted else "all"
            reported.append(f"{self.what}: {self.num_seen} looked at, {part} good")
        return reported


@dataclass(frozen=True, slots=True)
class Gap:
    """Gap of one check that ``audit.toml`` accepts up to and including a stated day."""

    reason: str
    until: datetime.date


@dataclass(frozen=True, slots=True)
class Allowed:
    """Content of ``audit.toml``: allowed licences, accepted advisories and accepted gaps."""

    licences: frozenset[str]
    known: dict[str, str]
    advisories: dict[str, datetime.date]
    gaps: dict[str, Gap] = field(default_factory=dict)
    """Accepted gaps by the name of the check."""


def read_allowed(path: Path) -> Allowed:
    """Read ``audit.toml``; raise an error for an entry without a reason or a last day."""
    document = tomllib.loads(path.read_text(encoding="utf-8"))
    licences = document.get("licences", {})
    known, advisories = {}, {}
    for entry in licences.get("known", []):
        if not entry.get("reason"):
            raise SystemExit(f"{path.name}: the licence of {entry.get('package')} needs a reason")
        known[str(entry["package"]).lower()] = str(entry["licence"])
    for entry in document.get("advisories", []):
        if not entry.get("reason") or not isinstance(entry.get("until"), datetime.date):
            raise SystemExit(f"{path.name}: the advisory {entry.get('id')} needs a reason and a date (until)")
        advisories[str(entry["id"]).upper()] = entry["until"]
    gaps = {}
    for entry in document.get("gaps", []):
        check = str(entry.get("check"))
        if check not in CHECKS:
            raise SystemExit(f"{path.name}: {check!r} is no check; expected one of: {'; '.join(CHECKS)}")
        if not entry.get("reason") or not isinstance(entry.get("until"), datetime.date):
            raise SystemExit(f"{path.name}: the gap of {check} needs a reason and a date (until)")
        gaps[check] = Gap(str(entry["reason"]), entry["until"])
    return Allowed(frozenset(licences.get("allowed", [])), known, advisories, gaps)


def judge_gaps(results: Iterable[Result], allowed: Allowed, today: datetime.date) -> None:
    """Mark each gap that ``audit.toml`` accepts as accepted; report every other gap as an error.

    A gap whose last day has passed is not accepted.
    """
    for result in results:
        gap = allowed.gaps.get(result.what)
        unseen, result.unseen = result.unseen, []
        for words in unseen:
            if gap is None:
                result.bad.append(f"NOT looked at: {words}; make the check possible, or accept the gap in audit.toml")
            elif gap.until < today:
                result.bad.append(f"NOT looked at: {words}; audit.toml accepted this gap until {gap.until}")
            else:
                result.accepted.append(f"until {gap.until}: {words} ({gap.reason})")


# ---------------------------------------------------------------- check of the licences


def licence_allowed(expression: str, allowed: Iterable[str]) -> bool:
    """Return whether an SPDX expression allows the use of a package.

    The expression may contain AND, OR, WITH, brackets, and ``A/B`` as old Cargo writes OR. An expression that cannot be
    parsed is not allowed.
    """
    names = frozenset(name.lower() for name in allowed)
    words = re.findall(r"[()]|[^\s()]+", expression.replace("/", " OR "))
    at = 0

    def either() -> bool:
        nonlocal at
        value = both()
        while at < len(words) and words[at].upper() == "OR":
            at += 1
            # Do not write `value or both()`: both() must consume its words in any case.
            right = both()
            value = value or right
        return value

    def both() -> bool:
        nonlocal at
        value = one()
        while at < len(words) and words[at].upper() == "AND":
            at += 1
            right = one()
            value = value and right
        return value

    def one() -> bool:
        nonlocal at
        if at >= len(words) or words[at].upper() in {"AND", "OR", "WITH", ")"}:
            raise ValueError(expression)
        if words[at] == "(":
            at += 1
            value = either()
            if at >= len(words) or words[at] != ")":
                raise ValueError(expression)
            at += 1
            return value
        name = words[at]
        at += 1
        if at + 1 < len(words) and words[at].upper() == "WITH":
            name = f"{name} WITH {words[at + 1]}"
            at += 2
        return name.lower() in names

    try:
        value = either()
    except ValueError:
        return False
    return value and at == len(words)


def _judge(result: Result, name: str, licence: str | None, allowed: Allowed) -> None:
    licence = allowed.known.get(name.lower(), licence)
    result.num_seen += 1
    if not licence:
        result.bad.append(f"{name} names no licence; look into its sources and add it to audit.toml")
    elif not licence_allowed(licence, allowed.licences):
        result.bad.append(f"{name} is under {licence!r}, which is not in audit.toml")


def rust_licences(root: Path, allowed: Allowed, run: Callable[..., Any] = subprocess.run) -> Result:
    """Return the check of the licences of all crates in the lock file whose sources are on this machine."""
    result = Result("licences, Rust")
    if shutil.which("cargo") is None:
        result.unseen.append("all crates: cargo is not installed")
        return result
    seen: dict[tuple[str, str], str | None] = {}
    for features in ([], ["--all-features"]):
        command = ["cargo", "metadata", "--offline", "--locked", "--format-version", "1", *features]
        done = run(command, cwd=root, capture_output=True, text=True, check=False)
        if done.returncode == 0:
            for package in json.loads(done.stdout)["packages"]:
                if package.get("source"):
                    seen[package["name"], package["version"]] = package.get("license")
    for (name, _), licence in sorted(seen.items()):
        _judge(result, name, licence, allowed)
    locked = tomllib.loads((root / "Cargo.lock").read_text(encoding="utf-8"))["package"]
    missing = sorted({p["name"] for p in locked if p.get("source")} - {name for name, _ in seen})
    if missing:
        shown = ", ".join(missing[:3]) + (", ..." if len(missing) > 3 else "")
        result.unseen.append(f"{len(missing)} crates that this build has not downloaded ({shown})")
    return result


def npm_licences(root: Path, allowed: Allowed) -> Result:
    """Return the check of the licences of all packages in the npm lock file, which contains the licences."""
    result = Result("licences, npm")
    lock = json.loads((root / "web" / "package-lock.json").read_text(encoding="utf-8"))
    for place, package in sorted(lock["packages"].items()):
        if place:
            licence = package.get("license")
            _judge(result, place.rpartition("node_modules/")[2], licence if isinstance(licence, str) else None, allowed)
    return result


def locked_python(root: Path) -> dict[str, str]:
    """Return the version of each Python package in the lock files, by its name."""
    found = {}
    for lock in LOCKS:
        for line in (root / lock).read_text(encoding="utf-8").splitlines():
            match = re.match(r"([A-Za-z0-9._-]+)(?:\[[^]]*\])?==([^\s;\\]+)", line)
            if match:
                found[match[1].lower()] = match[2]
    return found


def python_licence(about: Any) -> str | None:
    """Return the SPDX expression of the licence in a package's metadata, or that of its classifiers.

    None if there is none.
    """
    expression = about.get("License-Expression")
    if expression:
        return str(expression)
    named = [c.rpartition(" :: ")[2] for c in about.get_all("Classifier", []) if c.startswith("License :: ")]
    known = [CLASSIFIERS.get(name, name) for name in named if name != "OSI Approved"]
    if known:
        return " AND ".join(f"({name})" if " " in name else name for name in known)
    text = str(about.get("License") or "").strip()
    return text.splitlines()[0].removesuffix(" License") if text else None


def python_licences(root: Path, allowed: Allowed, about: Callable[[str], Any] = metadata.metadata) -> Result:
    """Return the check of the licences of all Python packages in the lock files that are installed on this machine."""
    result = Result("licences, Python")
    missing = []
    for name in sorted(locked_python(root)):
        try:
            found = about(name)
        except metadata.PackageNotFoundError:
            missing.append(name)
            continue
        _judge(result, name, python_licence(found), allowed)
    if missing:
        shown = ", ".join(missing[:3]) + (", ..." if len(missing) > 3 else "")
        result.unseen.append(f"{len(missing)} packages that are not installed here ({shown})")
    return result


# ---------------------------------------------------------------- check of the advisories


def judge_advisories(
    result: Result, found: Iterable[tuple[str, str, str]], allowed: Allowed, today: datetime.date
) -> None:
    """Add to the result each advisory (ID, package, text) that is not accepted, or not any more."""
    for number, package, words in sorted(set(found)):
        until = allowed.advisories.get(number.upper())
        if until is None:
            result.bad.append(f"{number} in {package}: {words}; update it, or except it in audit.toml with a reason")
        elif until < today:
            result.bad.append(f"{number} in {package}: its exception in audit.toml ended on {until}; look again")


def _json_output(result: Result, command: list[str], cwd: Path, run: Callable[..., Any]) -> Any:
    """Return the JSON output of a program; None if the program failed, with the reason added to the result."""
    tool = command[0] if command[0] != "cargo" else "cargo-audit"
    if shutil.which(tool) is None:
        remedy = f" (install it with: {TOOLS[tool]})" if tool in TOOLS else ""
        result.unseen.append(f"{tool} is not installed{remedy}")
        return None
    try:
        done = run(command, cwd=cwd, capture_output=True, text=True, check=False, timeout=WITHIN_S)
    except subprocess.TimeoutExpired:
        result.unseen.append(f"{tool} had no answer within {WITHIN_S:.0f} s")
        return None
    try:
        return json.loads(done.stdout)
    except ValueError:
        lines = [line.strip() for line in done.stderr.splitlines() if line.strip()]
        result.unseen.append(f"{tool} gave no report: {lines[-1][:160] if lines else f'exit {done.returncode}'}")
        return None


def rust_advisories(
    root: Path, allowed: Allowed, today: datetime.date, run: Callable[..., Any] = subprocess.run
) -> Result:
    """Return the check of the Rust advisories by ``cargo audit`` and RustSec's database."""
    result = Result("advisories, Rust")
    report = _json_output(result, ["cargo", "audit", "--json"], root, run)
    if report is None:
        return result
    database = report.get("database", {})
    if not database.get("advisory-count"):
        result.unseen.append("cargo-audit has no database")
        return result
    result.num_seen = int(report.get("lockfile", {}).get("dependency-count", 0))
    found = report.get("vulnerabilities", {}).get("list", [])
    rows = ((v["advisory"]["id"], v["package"]["name"], v["advisory"]["title"]) for v in found)
    judge_advisories(result, rows, allowed, today)
    return result


def python_advisories(
    root: Path, allowed: Allowed, today: datetime.date, run: Callable[..., Any] = subprocess.run
) -> Result:
    """Return the check of the Python advisories by ``pip-audit``.

    ``pip-audit`` lists packages that it could not check as "skipped" and exits with 0; here they are a gap.
    """
    result = Result("advisories, Python")
    command = ["pip-audit", "--format", "json", "--progress-spinner", "off", "--no-deps", "--disable-pip"]
    for lock in LOCKS:
        command += ["--requirement", lock]
    report = _json_output(result, command, root, run)
    if report is None:
        return result
    rows = report.get("dependencies", []) if isinstance(report, dict) else report
    skipped = [row["name"] for row in rows if row.get("skip_reason")]
    result.num_seen = len(rows) - len(skipped)
    if skipped or not rows:
        result.unseen.append(f"pip-audit could not look up {len(skipped)} of {len(rows)} packages")
    found = (
        (v["id"], row["name"], f"mended in {', '.join(v.get('fix_versions') or ['no version yet'])}")
        for row in rows
        for v in row.get("vulns", [])
    )
    judge_advisories(result, found, allowed, today)
    return result


def npm_advisories(
    root: Path, allowed: Allowed, today: datetime.date, run: Callable[..., Any] = subprocess.run
) -> Result:
    """Return the check of the npm advisories by ``npm audit`` and the registry."""
    result = Result("advisories, npm")
    report = _json_output(
        result, ["npm", "audit", "--json", "--package-lock-only", "--fetch-retries=0"], root / "web", run
    )
    if report is None:
        return result
    if "vulnerabilities" not in report or "metadata" not in report:
        words = str(report.get("message") or report.get("error") or "no report")
        result.unseen.append(f"npm audit: {words[:160]}")
        return result
    result.num_seen = int(report["metadata"].get("dependencies", {}).get("total", 0))
    found = []
    for name, entry in report["vulnerabilities"].items():
        for via in entry.get("via", []):
            # A text instead of a dictionary names another package of the report, through which the package is affected.
            if isinstance(via, dict):
                number = str(via.get("url", "")).rpartition("/")[2] or str(via.get("source"))
                found.append((number, name, str(via.get("title", ""))))
    judge_advisories(result, found, allowed, today)
    return result


def main() -> int:
    """Run all checks and print the results; return 1 for a bad licence, an advisory, or a gap that is not accepted."""
    allowed = read_allowed(ROOT / "tools" / "audit.toml")
    today = datetime.datetime.now(tz=datetime.UTC).date()
    with ThreadPoolExecutor() as pool:
        looks = [
            pool.submit(rust_licences, ROOT, allowed),
            pool.submit(npm_licences, ROOT, allowed),
            pool.submit(python_licences, ROOT, allowed),
            pool.submit(rust_advisories, ROOT, allowed, today),
            pool.submit(npm_advisories, ROOT, allowed, today),
            pool.submit(python_advisories, ROOT, allowed, today),
        ]
        results = [look.result() for look in looks]
    judge_gaps(results, allowed, today)
    for result in results:
        print("\n".join(result.lines()))
    return 1 if any(result.bad for result in results) else 0


if __name__ == "__main__":
    sys.exit(main())
