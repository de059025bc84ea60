"""Model + datasets → fit: one-pass least squares, variable projection for time constants, honest covariance."""

from bench.fit.fitting import Coefficient, Fit, Prediction, fit

__all__ = ["Coefficient", "Fit", "Prediction", "fit"]
