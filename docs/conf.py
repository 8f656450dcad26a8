"""How the documentation is built: ``make docs``. Every warning is an error there."""

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
