"""MCAP files, also damaged ones."""
