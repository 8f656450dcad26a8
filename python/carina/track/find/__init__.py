"""Search for the airways in a volume: trachea, growth of the lumen, small airways, and doubts about the result."""
