"""Messages as bytes and their columns."""
