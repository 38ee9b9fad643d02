"""H-infinity norms: one iteration over levels, and the models of the gain that it asks."""
