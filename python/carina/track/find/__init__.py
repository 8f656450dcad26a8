"""From a volume to its airways: trachea, growth, what lies beyond, and what is to be doubted."""
