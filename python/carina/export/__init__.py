"""File formats."""

from carina.export.tree_file import read_tree, write_tree

__all__ = ["read_tree", "write_tree"]
