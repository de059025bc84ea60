"""Model + datasets → fit: one-pass least squares, variable projection for time constants, honest covariance."""
