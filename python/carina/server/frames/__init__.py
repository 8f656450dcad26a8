"""The frame pump: choice, resolution and pace of the pictures of a window."""
