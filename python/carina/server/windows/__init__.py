"""Connected windows: commands in, messages out, and answers while the user points."""
