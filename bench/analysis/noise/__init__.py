"""The noise of a gyro: Allan deviation, whitening, likelihood, and the estimate of white, flicker and random walk."""
