"""Pointing errors, their metrics and confidence bounds."""
