"""What the commands do, each one call with an `Answer` that prints as text or as JSON."""
