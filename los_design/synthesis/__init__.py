"""Synthesis of the controllers."""
