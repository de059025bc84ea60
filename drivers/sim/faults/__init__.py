"""Faults of the wire, switched on and off by name while the bench runs: `proxy` for Modbus, `bus` for CAN."""
