"""A unit from the shelf to shipped in one command: a plan, its steps, and a job file that every step leaves behind."""
