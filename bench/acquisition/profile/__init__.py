"""What to do: segments, guards and profiles in YAML, and what can be known before anything moves."""
