"""Logistic regression, as the calibration programs need it."""

from __future__ import annotations

import numpy as np

from elevator_rectify.core.types import Array

_STEPS = 60


def logistic_regression(X: Array, y: Array, weights: Array, ridge: float) -> Array:
    """Return the ridge-regularised coefficients by Newton's method (iteratively reweighted least squares).

    X (N, P), y (N,) of 0 and 1, weights (N,) of the examples. (Hastie, Tibshirani and Friedman, 4.4)
    """
    beta = np.zeros(X.shape[1])
    for _ in range(_STEPS):
        p = 1.0 / (1.0 + np.exp(-np.clip(X @ beta, -30, 30)))
        hessian = (X * (weights * p * (1 - p))[:, None]).T @ X + ridge * np.eye(X.shape[1])
        beta = beta + np.linalg.solve(hessian, X.T @ (weights * (y - p)) - ridge * beta)
    return beta
