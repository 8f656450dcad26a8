"""Commands on the appearance of the case, and questions about a point."""
