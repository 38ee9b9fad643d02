"""Norms and responses on the unit circle, of discrete systems."""
