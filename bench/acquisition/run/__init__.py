"""One execution of a profile: the sequencer, its control from outside, and how it ends or goes on."""
