"""Systems connected by the names of their ports."""
