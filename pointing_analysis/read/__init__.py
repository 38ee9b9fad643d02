"""Recordings: bags, tables and arrays of others."""
