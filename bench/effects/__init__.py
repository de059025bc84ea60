"""Physical effects a gyro's zero-rate output may show, one a file."""
