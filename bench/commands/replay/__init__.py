"""A run made again from its raw frames: the same numbers bit for bit, or what differs and in which row."""
