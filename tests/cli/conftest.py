"""The command line as a person runs it, in this process: arguments in, exit code and both outputs back."""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass

import pytest

from carina.cli import main
from carina.phantom import write_phantom
from made import made_phantom
from own_folders import own_folders


@dataclass
class Ended:
    """How a command ended."""

    code: int
    out: str
    err: str

    def json(self):
        """The one object on stdout; anything beside it does not parse."""
        value = json.loads(self.out, parse_constant=lambda name: pytest.fail(f"{name} in JSON"))
        assert isinstance(value, dict)
        return value


@pytest.fixture
def carina(monkeypatch, capfd, tmp_path):
    """Runs ``carina ARGUMENTS``; the person's own folders are temporary."""
    for name, folder in own_folders(tmp_path / "home").items():
        monkeypatch.setenv(name, folder)

    def run(*arguments):
        monkeypatch.setattr(sys, "argv", ["carina", *map(str, arguments)])
        capfd.readouterr()
        with pytest.raises(SystemExit) as end:
            main()
        out, err = capfd.readouterr()
        assert "Traceback" not in err
        code = end.value.code
        return Ended(0 if code is None else code, out, err)

    return run


@pytest.fixture(scope="session")
def phantom_folder(tmp_path_factory):
    """A chest at 2.5 mm: small enough to be opened in every test, fine enough for the main airways."""
    folder = tmp_path_factory.mktemp("phantom")
    write_phantom(made_phantom(spacing_mm=2.5, generations=4), folder)
    return folder


@pytest.fixture(scope="session")
def ct(phantom_folder):
    """Its CT."""
    return phantom_folder / "ct.nii.gz"
