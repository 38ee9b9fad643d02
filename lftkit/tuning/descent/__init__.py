"""Descent of the tuner: starts, bundle and quasi-Newton steps, smooth phases."""
