"""Uncertain parameters."""
