"""Model + datasets → fit: one-pass least squares, variable projection for time constants, honest covariance."""

from bench.analysis.fit.fitting import Coefficient, Fit, Prediction, fit_model, refuse_corrected

__all__ = ["Coefficient", "Fit", "Prediction", "fit_model", "refuse_corrected"]
