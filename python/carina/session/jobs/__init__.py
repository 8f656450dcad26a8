"""Jobs in the background: groups, progress, cancellation and memory."""
