"""Tests of the page of ``help(carina)``, which names every public object."""

from __future__ import annotations

import pydoc

import carina


def test_help_of_the_package_has_the_length_of_one_page() -> None:
    assert len(pydoc.plain(pydoc.render_doc(carina)).splitlines()) < 100


def test_package_docstring_names_every_public_object() -> None:
    assert [name for name in carina.__all__ if name != "__version__" and name not in (carina.__doc__ or "")] == []


def test_star_import_gives_every_public_object() -> None:
    namespace: dict[str, object] = {}
    exec("from carina import *", namespace)
    assert set(carina.__all__) <= set(namespace)
