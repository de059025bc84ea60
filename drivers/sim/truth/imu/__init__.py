"""The truth of a simulated inertial unit: three gyros and three accelerometers on dies, in a fixture, on a table."""
