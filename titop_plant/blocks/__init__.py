"""Bodies and mechanisms as uncertain systems with ports."""
