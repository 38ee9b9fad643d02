"""Shared parts of the nodes."""
