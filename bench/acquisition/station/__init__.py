"""The equipment of a run: chamber, buses, units, rate table, their safe state and their watchdog."""
