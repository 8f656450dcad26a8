"""State of a session for its windows, as frozen values."""
