"""Reject forbidden content of the repository, dead paths in documents, and citations of missing decisions and papers.

Forbidden are machine paths, hosts in lock files, and large files. A decision must have five headings, the name of its
title, and at most 600 words.
"""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
MAX_BYTES = 2 * 1024 * 1024
"""Maximum size of a file in the repository, bytes."""
BIG_FILES = {"python/carina/_cases/"}  # The bundled patient case (CC BY) may be larger.
NAMED_PATH = re.compile(
    r"`((?:crates|packages|python|web|tests|tools|docs|examples|benchmarks|protocol|build_backend)/[\w./*-]*)`"
)
"""Pattern of a path in backticks in a document; its existence is checked."""
ELSEWHERE = re.compile(r"\b(?:DESIGN|STYLE)(?:\.md| section| \d|:)|\bissue \d+|\breference/\w+\.md")
"""Pattern of citations of working papers outside the repository, which are refused; their content is in docs/."""
CITED_DECISION = re.compile(r"\bdecisions?[ /](\d{4})\b", re.IGNORECASE)
"""Pattern of the citation of a decision; group 1 is the number of the decision."""
DECISION_HEADINGS = ["Context", "Decision", "Reasons", "Alternatives", "What would change this"]
"""Headings of a decision, in this order."""
MAX_DECISION_WORDS = 600
"""Maximum number of words of a decision; docs/writing.md recommends about 450."""
GENERATED = ("benchmarks/results", "tests/out", "python/carina/_web")
"""Beginnings of the paths of generated files, which documents may name although git does not contain them."""
HOME_PATH = re.compile(rb"(?<![\w.])/(?:home|root|Users)/[A-Za-z0-9._-]+/")
"""Pattern of a path in the home folder of a user, which must not be in a file of the repository."""
TEXT = {".py", ".rs", ".ts", ".tsx", ".md", ".toml", ".json", ".html", ".css", ".lock", ".txt", ".yml", ".sh", ""}
"""Suffixes of the text files whose characters are checked."""


def tracked_files() -> list[str]:
    """Return the paths of the files in the index of git."""
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, check=True, capture_output=True)
    return [name for name in listed.stdout.decode().split("\0") if name]


def dead_paths(name: str) -> list[str]:
    """Return a finding for each path in a document that does not exist."""
    text = (ROOT / name).read_text(encoding="utf-8")
    found = []
    for path in sorted(set(NAMED_PATH.findall(text))):
        if "NNNN" not in path and not path.startswith(GENERATED) and not any(ROOT.glob(path.rstrip("/"))):
            found.append(f"{name}: names {path}, which does not exist")
    return found


def dead_decisions(name: str, text: str) -> list[str]:
    """Return a finding for each cited decision number of a file that no decision has."""
    cited = sorted(set(CITED_DECISION.findall(text)))
    return [
        f"{name}: cites decision {number}, which does not exist; docs/decisions/index.md maps former numbers"
        for number in cited
        if not any(ROOT.glob(f"docs/decisions/{number}-*.md"))
    ]


def decision_problems(file_name: str, text: str) -> list[str]:
    """Return a finding for each rule of decisions that a page breaks.

    Parameters
    ----------
    file_name
        Name of the file without its folder.
    text
        Content of the page.
    """
    found = []
    title = re.match(r"# (\d{4}): (.+)\n", text)
    if title is None:
        found.append("the first line is not '# NUMBER: TITLE'")
    else:
        number, words = title.groups()
        slug = re.sub(r"[^a-z0-9]+", "-", words.lower().replace("'", "")).strip("-")
        if file_name != f"{number}-{slug}.md":
            found.append(f"the file name of this title is {number}-{slug}.md")
    headings = re.findall(r"^## (.+)$", text, re.MULTILINE)
    if headings != DECISION_HEADINGS:
        found.append(f"the headings are {headings}, not {DECISION_HEADINGS}")
    if (num_words := len(text.split())) > MAX_DECISION_WORDS:
        found.append(f"the page has {num_words} words, at most {MAX_DECISION_WORDS} are allowed")
    return [f"docs/decisions/{file_name}: {problem}" for problem in found]


def main() -> int:
    """Print every finding of the checks of the repository; return 1 if there is one."""
    if not (ROOT / ".git").exists():
        print("repository: not a git checkout, nothing to check")
        return 0
    found = []
    for name in tracked_files():
        path = ROOT / name
        if not path.is_file():
            continue
        if path.stat().st_size > MAX_BYTES and not any(name.startswith(prefix) for prefix in BIG_FILES):
            found.append(f"{name}: {path.stat().st_size // 1024} KiB; big files do not belong in git")
        if path.name == "uv.lock":
            found.append(f"{name}: names registry hosts; commit requirements.lock instead (make lock)")
        if path.suffix == ".md":
            found += dead_paths(name)
            if path.parent == ROOT / "docs" / "decisions" and path.name != "index.md":
                found += decision_problems(path.name, path.read_text(encoding="utf-8"))
        if path.suffix in TEXT:
            body = path.read_bytes()
            if match := HOME_PATH.search(body):
                found.append(f"{name}: holds a path of somebody's machine ({match.group().decode()})")
            if path.suffix in {".py", ".rs", ".ts", ".tsx", ".md", ".toml"} and path != Path(__file__).resolve():
                found += dead_decisions(name, body.decode("utf-8", errors="replace"))
                for match in ELSEWHERE.finditer(body.decode("utf-8", errors="replace")):
                    found.append(f"{name}: cites {match.group()!r}, which is not in the repository; cite docs/")
            if path.name == "package-lock.json" and b'"resolved"' in body:
                found.append(f"{name}: names registry hosts; run npm with web/.npmrc (omit-lockfile-registry-resolved)")
    for line in found:
        print(line)
    if not found:
        print("repository: nothing that must not be committed")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
