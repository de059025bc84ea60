"""The project of others below is collected by the runs of pytest that test it, never by this one."""

collect_ignore = ["project"]
