"""Commands on targets, routes and plans."""
