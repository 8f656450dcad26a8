"""The open case: its state, its start pose and the queries that every command shares."""
