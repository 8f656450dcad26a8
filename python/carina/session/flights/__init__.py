"""Commands that move the tip, and recordings of flights."""
