"""Tuning for all values of uncertain parameters, by rounds of worst cases."""
