"""Pointing requirements and verdicts."""
