"""How the documentation is built: ``make docs``. Every warning is an error there."""

from typing import Any

project = "Carina"
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
html_theme = "furo"
exclude_patterns = []
myst_heading_anchors = 3
napoleon_google_docstring = False
autodoc_typehints = "signature"
autodoc_member_order = "alphabetical"
autodoc_default_options = {"members": True, "imported-members": True}
default_role = "code"
html_copy_source = False
html_show_sourcelink = False


def _keep_whole(_app: Any, what: str, _name: str, _obj: Any, _options: Any, lines: list[str]) -> None:
    """Napoleon takes what stands before a colon in an attribute's first line for its type; ours is in the signature."""
    if what in {"attribute", "data", "property"} and lines and ":" in lines[0]:
        lines[:0] = ["..", ""]


def setup(app: Any) -> None:
    """Before Napoleon, which listens at 500."""
    app.connect("autodoc-process-docstring", _keep_whole, priority=400)
