"""Simulated equipment: physics without I/O (plant, resonator) and the wires that carry it (Modbus, CAN)."""
