"""Routes to a target outside the airways, with their last leg and their rank."""
