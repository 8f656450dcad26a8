"""Tests of invalid values of every option of every command: they are refused before the command begins its work.

Options without effect are refused as well.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import typer
from typer.core import TyperOption

from carina.cli.app import app
from carina.errors import CarinaError

NEVER = (
    "nan", "inf", "-inf", "1e300", "-1e300", "99999999999999999999", "", " ", "no-such-thing", "1,2", "nan,nan,nan",
    "x" * 5000,
)  # fmt: skip
"""Values that every command must refuse: outside every numeric range, and not the name of an output file."""
WORDS = (*NEVER, "-1", "0")
FEW_WORDS = ("nan", "99999999999999999999", "")
"""Values of :data:`NEVER` that ``make test`` tries; the soak test tries all of them."""
NUMBER_TYPES = {str(kind) for kind in (int, float, int | None, float | None)}
SUFFIXED = {"airways", "export", "track", "plan", "render", "isoregion", "fly", "case recording"}
"""Commands that select the format of their output by its suffix."""
POINT = "-20.2,3.0,-26.6"
GOOD: dict[str, list[str]] = {
    "airways": ["CT"],
    "bench": [],
    "case forget": ["no-such-case", "--yes"],
    "case history": ["NAME.carina"],
    "case info": ["NAME.carina"],
    "case list": [],
    "case migrate": ["NAME.carina", "-o", "new.carina"],
    "case pack": ["NAME.carina", "-o", "new.carina"],
    "case recording": ["NAME.carina", "Flight 1", "-o", "flight.jsonl"],
    "case rescue": ["NAME.carina", "-o", "new.carina"],
    "cluster join": ["10.0.0.5"],
    "cluster start": ["--head"],
    "cluster status": ["10.0.0.5"],
    "demo": [],
    "devices": [],
    "doctor": [],
    "export": ["CT", "-o", "tree.json"],
    "fly": ["CT", "--to", POINT, "-o", "flight.mp4"],
    "info": ["CT"],
    "deidentify": ["CT", "copy"],
    "pacs add": ["hospital", "--host", "127.0.0.1"],
    "pacs get": ["hospital", "1.2.3", "1.2.3.4", "-o", "scan"],
    "pacs list": [],
    "pacs remove": ["hospital"],
    "pacs search": ["hospital", "--date", "2026-11-30"],
    "pacs store": ["hospital", "CT"],
    "pacs test": ["hospital"],
    "isoregion": ["CT", "-o", "map.nrrd"],
    "open": ["CT", "--no-browser"],
    "phantom": ["-o", "made"],
    "plan": ["CT", "--target", POINT, "-o", "plan.html"],
    "render": ["CT", "-o", "picture.png"],
    "score": ["flight.jsonl", "CT"],
    "course": ["Blue heron"],
    "insert": ["CT", "-o", "marked.nii.gz"],
    "track": ["CT", "--target", POINT],
}
"""Valid arguments of each command, with which it begins its work."""


class WorkBeganError(CarinaError):
    """Error that is raised in place of the work of a command whose arguments were accepted."""

    code = "test.work"
    exit_code = 3


def all_commands() -> dict[str, Any]:
    """Return each command with its full name, such as ``case info``."""
    group: Any = typer.main.get_command(app)
    found: dict[str, Any] = {}
    for name, command in group.commands.items():
        below = getattr(command, "commands", None)
        found.update({name: command} if below is None else {f"{name} {one}": each for one, each in below.items()})
    return found


COMMANDS = all_commands()
UNATTENDED = sorted(set(COMMANDS) - {"bench", "cluster join", "cluster start", "cluster status", "devices", "doctor"})
"""Commands that the test may run, because they need no network, no device and no cluster."""


def test_table_of_valid_arguments_contains_every_command() -> None:
    assert sorted(COMMANDS) == sorted(GOOD)


@pytest.fixture
def no_work(monkeypatch: pytest.MonkeyPatch) -> None:
    """Stop every command at the beginning of its work."""

    def begin(*_arguments: object, **_options: object) -> None:
        raise WorkBeganError("the work began")

    for name in ("airways", "plan", "track", "render", "isoregion", "fly"):
        monkeypatch.setattr(f"carina.cli.{name}.open_input", begin)
    monkeypatch.setattr("carina.cli.info.inspect_path", begin)
    monkeypatch.setattr("carina.server.serve", begin)
    monkeypatch.setattr("carina._core.generate_chest", begin)


def wrong_calls(name: str, words: tuple[str, ...]) -> list[tuple[str, list[str], bool]]:
    """Return the calls with one wrong value for each value and each parameter of a command.

    A call is a description, the arguments, and whether the command must refuse them.
    """
    found = []
    for parameter in COMMANDS[name].params:
        is_option = isinstance(parameter, TyperOption)
        if (is_option and parameter.is_flag) or parameter.name == "help":
            continue
        for word in words:
            good = list(GOOD[name])
            if is_option:
                option = max(parameter.opts, key=len)
                for one in parameter.opts:
                    if one in good:
                        at = good.index(one)
                        del good[at : at + 2]
                arguments = [*good, f"{option}={word}"] if option.startswith("--") else [*good, option, word]
            else:
                place = [p for p in COMMANDS[name].params if not isinstance(p, TyperOption)].index(parameter)
                arguments = [*good]
                arguments[place : place + 1] = [word]
            is_number = str(parameter.type_descriptor.annotation) in NUMBER_TYPES
            is_output = parameter.name == "output" and name in SUFFIXED
            refuse = not word.strip() or (is_number and word in NEVER) or (is_output and word in NEVER)
            found.append((f"{name} {parameter.name}={word[:30]!r}", [*name.split(), *arguments], refuse))
    return found


@pytest.mark.usefixtures("no_work")
@pytest.mark.parametrize(
    "words", [pytest.param(FEW_WORDS, id="few"), pytest.param(WORDS, id="all", marks=pytest.mark.soak)]
)
@pytest.mark.parametrize("name", UNATTENDED)
def test_command_refuses_invalid_option_values_before_the_computation(  # noqa: PLR0917 - fixtures and parameters
    name: str, words: tuple[str, ...], carina: Any, ct: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    work = tmp_path / "work"
    work.mkdir()
    monkeypatch.chdir(work)
    problems = []
    for title, arguments, refuse in wrong_calls(name, words):
        ended = carina(*(str(ct) if word == "CT" else word for word in arguments))
        if "internal error" in ended.err or ended.code not in {0, 1, 2, 3, 4}:
            problems.append(f"{title}: exit {ended.code}: {ended.err.strip()[-200:]}")
        elif refuse and ended.code != 2:
            problems.append(f"{title}: exit {ended.code} instead of 2: {ended.err.strip()[-200:]}")
        elif len(ended.err) > 4000 or max(map(len, ended.err.splitlines()), default=0) > 2000:
            problems.append(f"{title}: a message of {len(ended.err)} characters")
    assert not problems, "\n".join(problems)


@pytest.mark.usefixtures("no_work")
@pytest.mark.parametrize(
    ("arguments", "option"),
    [
        (["plan", "CT", "--target", POINT, "--structure", "x"], "--structure"),
        (["plan", "CT", "--target", POINT, "--tracing-sheet"], "--tracing-sheet"),
        (["plan", "CT", "--target", POINT, "--tracing-sheet", "-o", "plan.json"], "--tracing-sheet"),
        (["plan", "CT", "--target", POINT, "--paper", "Letter", "-o", "plan.html"], "--paper"),
        (["plan", "CT", "--target", POINT, "--no-clips", "-o", "plan.pdf"], "--no-clips"),
        (["plan", "CT", "--target", POINT, "--with-identity", "-o", "plan.html"], "--with-identity"),
        (["export", "CT", "-o", "a.json", "--tree", "a.json", "--from-mask", "m.nii"], "--from-mask"),
        (["airways", "CT", "--label", "3"], "--label"),
        (["airways", "CT", "--even-without-evidence"], "--even-without-evidence"),
        (["fly", "CT", "--keys", "k.json", "--speed", "5", "-o", "a.mp4"], "--speed"),
        (["fly", "CT", "--recording", "r.jsonl", "--pause", "5", "-o", "a.mp4"], "--pause"),
        (["fly", "CT", "--recording", "r.jsonl", "--scope", "thin", "-o", "a.mp4"], "--scope"),
        (["fly", "CT", "--to", POINT, "--mixed", "-o", "a.mp4"], "--mixed"),
        (["fly", "CT", "--to", POINT, "--token-file", "t", "-o", "a.mp4"], "--token-file"),
        (["open", "CT", "--mixed"], "--mixed"),
        (["open", "CT", "--phone-address", "10.0.0.5"], "--phone-address"),
        (["demo", "--phone-address", "10.0.0.5"], "--phone-address"),
        (["open", "CT", "--ct", "x"], "--ct"),
        (["cluster", "start", "--head", "--no-renders", "--dedicated"], "--dedicated"),
        (["render", "CT", "-o", "a.png", "--outline", "round", "--mask", "round"], "--mask"),
        (["render", "CT", "-o", "a.png", "--view", "axial", "--fov", "50"], "--fov"),
        (["render", "CT", "-o", "a.png", "--view", "axial", "--look", "0,0,1"], "--look"),
        (["render", "CT", "-o", "a.png", "--view", "axial", "--shading", "off"], "--shading"),
        (["render", "CT", "-o", "a.png", "--view", "axial", "--transfer", "paper"], "--transfer"),
        (["render", "CT", "-o", "a.png", "--view", "airway", "--window", "100,0"], "--window"),
        (["render", "CT", "-o", "a.png", "--view", "airway", "--orbit", "1,2"], "--orbit"),
        (["render", "CT", "-o", "a.png", "--view", "drr", "--turn", "20"], "--turn"),
        (["render", "CT", "-o", "a.png", "--view", "tree", "--tone", "fluoroscopy"], "--tone"),
        (["render", "CT", "-o", "a.png", "--view", "axial", "--carm-primary", "20"], "--carm-primary"),
        (["render", "CT", "-o", "a.png", "--view", "axial", "--step-vox", "2"], "--step-vox"),
        (["render", "CT", "-o", "a.png", "--view", "coronal", "--method", "brute"], "--method"),
    ],
    ids=str,
)
def test_option_without_effect_on_the_command_is_refused(  # noqa: PLR0917 - fixtures and parameters
    carina: Any, ct: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, arguments: list[str], option: str
) -> None:
    monkeypatch.chdir(tmp_path)
    ended = carina(*(str(ct) if word == "CT" else word for word in arguments), "--json")
    assert ended.code == 2, ended.err
    assert option in ended.json()["error"]["message"]
