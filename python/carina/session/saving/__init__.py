"""Saving of the open case: the live file, the named file and unsaved work."""
