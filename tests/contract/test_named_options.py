"""Tests that each option named in a message exists in the command that prints the message."""

from __future__ import annotations

import ast
import functools
import re
from pathlib import Path

import pytest
import typer

import carina
from carina.cli.app import app
from carina.errors import without_options

SOURCE = Path(carina.__file__).parent
OPTION = re.compile(r"(?<![\w-])--[a-z][a-z-]*")

FOREIGN = {
    "cluster/node.py": "options of `ray start`, except those that are checked below",
    "installation.py": "options of pip and uv",
    "server/wire/generate.py": "an option of the generator of TypeScript types",
}
OF_CT = ("info", "airways", "export", "track", "plan", "render", "isoregion", "fly", "score", "insert")
PRINTED_BY: dict[str, tuple[str, ...]] = {
    "cli/adding.py": ("airways",),
    "cli/airways.py --add-branch": ("airways",),
    "cli/airways.py --even-without-evidence": ("airways",),
    "cli/airways.py --mask": ("airways",),
    "cli/airways.py": ("export",),
    "cli/along.py": ("fly", "render"),
    "cli/arguments.py": ("fly", "render"),
    "cli/case.py": ("case forget",),
    "cli/cluster.py": ("open", "fly"),
    "cli/deidentify.py": ("deidentify",),
    "cli/devices.py": ("devices",),
    "cli/fly.py": ("fly",),
    "cli/info.py": ("info",),
    "cli/isoregion.py": ("isoregion",),
    "cli/xray_set.py": ("render",),
    "render/isoregion_file.py": ("isoregion",),
    "cli/score.py": ("score",),
    "cli/course.py": ("course",),
    "cli/insert.py": ("insert",),
    "training/insert_nodule.py": ("insert",),
    "cli/stored_frames.py": ("fly",),
    "cli/pacs.py": ("pacs search",),
    "cli/opened.py --ct": OF_CT,
    "cli/opened.py --keys": ("fly",),
    "cli/opened.py --strict": (
        "open",
        "airways",
        "export",
        "track",
        "plan",
        "render",
        "isoregion",
        "fly",
        "score",
        "insert",
    ),
    "cli/optics.py": ("render",),
    "cli/plan.py": ("plan",),
    "cli/render.py": ("render",),
    "cli/track.py": ("track",),
    "cluster/node.py --head": ("cluster start",),
    "cluster/ray_backend.py": ("cluster start",),
    "pacs/dimse_client.py": ("pacs add",),
    "pacs/reasons.py": ("pacs add",),
    "server/pacs_requests.py": ("pacs add",),
    "plan/targets/doubts.py": ("plan",),
    "plan/targets/from_file.py": ("plan",),
    "plan/targets/from_mask.py": ("plan",),
    "server/network/listening.py": ("open", "demo"),
    "server/serve.py": ("open", "demo"),
    "volume/isoregion_bundle.py": ("isoregion",),
    "volume/mask_files.py --label": ("airways", "export"),
    "volume/mask_files.py --resample": ("airways", "export", "plan"),
}
"""Commands that print the messages of a module, or only those messages of it that contain an option."""


@functools.cache
def options() -> dict[str, set[str]]:
    """Return the options of each command of ``carina``, by the command's name."""
    found: dict[str, set[str]] = {}

    def walk(command, name):
        for word, part in getattr(command, "commands", {}).items():
            walk(part, f"{name} {word}".strip())
        found[name] = {one for part in command.params for one in (*part.opts, *part.secondary_opts)}

    walk(typer.main.get_command(app), "")
    return found


@functools.cache
def named() -> list[tuple[str, str, int]]:
    """Return the options in texts of the package as (module, option, line).

    Docstrings and definitions of options are omitted.
    """
    found = []
    for path in sorted(SOURCE.rglob("*.py")):
        module = path.relative_to(SOURCE).as_posix()
        text = path.read_text(encoding="utf-8")
        if not OPTION.search(text):
            continue
        tree = ast.parse(text)
        left_out = set()
        for node in ast.walk(tree):
            if isinstance(node, ast.Expr):
                left_out.add(id(node.value))
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr == "Option":
                left_out.update(id(one) for one in ast.walk(node))
        for node in ast.walk(tree):
            if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in left_out:
                found += [(module, option, node.lineno) for option in OPTION.findall(node.value) if option != "--help"]
    return found


def test_every_option_in_a_message_exists_in_the_commands_that_print_it():
    known = options()
    wrong = []
    for module, option, line in named():
        commands = PRINTED_BY.get(f"{module} {option}", PRINTED_BY.get(module))
        if commands is None and module.startswith("cli/app"):
            # The modules cli/app* define the options, so an option of any command is accepted.
            if not any(option in own for own in known.values()):
                wrong.append(f"{module}:{line} names {option}, which no command has")
            continue
        if commands is None:
            if module not in FOREIGN:
                wrong.append(f"{module}:{line} names {option}: say in PRINTED_BY which commands print it")
            continue
        wrong += [
            f"{module}:{line} names {option}, which `{one}` lacks" for one in commands if option not in known[one]
        ]
    assert not wrong, "\n".join(wrong)


def test_table_of_options_names_existing_messages_and_commands():
    known, places = options(), {(module, option) for module, option, _ in named()}
    modules = {module for module, _ in places}
    for key, commands in PRINTED_BY.items():
        module, _, option = key.partition(" ")
        assert (module, option) in places if option else module in modules, key
        assert set(commands) <= set(known), key


def test_help_texts_name_options_of_their_own_command():
    wrong = []

    def walk(command, name):
        for word, part in getattr(command, "commands", {}).items():
            walk(part, f"{name} {word}".strip())
        texts = [command.help or "", *(getattr(part, "help", None) or "" for part in command.params)]
        for text in texts:
            # A text may refer the user to another command.
            commands = {name, *(other for other in options() if f"carina {other} " in text)}
            own = {"--help"}.union(*(options()[one] for one in commands))
            wrong.extend(f"{name}: {one}" for one in OPTION.findall(text) if one not in own)

    walk(typer.main.get_command(app), "")
    assert not wrong


@pytest.mark.parametrize(
    ("message", "expected"),
    [
        ("choose one (--label, or label=N in Python)", "choose one"),
        ("give a point (--part, or at_lps= in Python), or a mask", "give a point, or a mask"),
        ("it contains the labels 1 (lung), 2 (node)", "it contains the labels 1 (lung), 2 (node)"),
    ],
)
def test_message_shown_in_the_window_contains_no_command_line_options(message, expected):
    assert without_options(message) == expected
