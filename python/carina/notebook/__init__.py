"""Linked views of a case in a notebook."""

from carina.notebook.case_view import CaseView, show

__all__ = ["CaseView", "show"]
