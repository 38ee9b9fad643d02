"""Figures of the plant and the designs."""
