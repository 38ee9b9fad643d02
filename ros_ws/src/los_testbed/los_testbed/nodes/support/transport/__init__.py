"""Serialised messages between nodes and middleware."""
