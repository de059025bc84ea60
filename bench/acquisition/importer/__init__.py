"""A table of somebody else becomes a run folder: tables, columns, units, branches, and the plan of it all."""
