"""What is stored: runs, units, fleet."""
