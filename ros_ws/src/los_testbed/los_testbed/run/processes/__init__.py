"""Processes of a run: their start, their surroundings and their end."""
