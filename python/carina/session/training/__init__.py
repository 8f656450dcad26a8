"""Training in a session: attempts at tasks, and the scores of flights."""
