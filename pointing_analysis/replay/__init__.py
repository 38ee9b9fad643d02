"""Recorded sensor values through a controller."""
