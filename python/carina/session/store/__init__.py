"""Files of the user's cases on this machine: registry, named files, locks and settings."""
