"""Benchmarks: how right, how honest and how fast the estimators are."""
