"""Equipment of the bench: chambers over Modbus, gyros over CAN, and their simulators. Never imports bench."""
