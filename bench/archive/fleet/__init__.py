"""Many units: yield, capability, control charts, drift of stations and lots, units unlike their lot, and refits."""
