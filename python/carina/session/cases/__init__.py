"""Commands that open, close and list cases."""
