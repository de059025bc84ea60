"""A run in a terminal: progress, keys, and the picture of what is under way."""
