"""Search for worst parameter points."""
