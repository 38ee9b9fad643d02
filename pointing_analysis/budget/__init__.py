"""Pointing budgets."""
