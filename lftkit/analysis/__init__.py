"""Frequency responses, norms, peaks and their plots."""
