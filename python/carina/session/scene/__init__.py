"""Content of the pictures of a case, as values that the render thread reads without locks."""
