"""Outputs that appear whole or not at all; text files of others with limits."""
