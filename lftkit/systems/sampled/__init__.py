"""Discrete systems with named ports, and the bilinear map."""
