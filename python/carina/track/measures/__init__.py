"""What airways measure: sections, branches, forks."""
