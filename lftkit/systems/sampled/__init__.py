"""Discrete systems with named ports, and sampling of continuous ones."""
