"""Programs of the user that attach to a case which is open in Carina."""
