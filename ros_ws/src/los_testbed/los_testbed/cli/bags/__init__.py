"""Commands on bags."""
