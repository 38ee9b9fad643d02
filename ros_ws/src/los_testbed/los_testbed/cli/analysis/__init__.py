"""Commands that judge recordings."""
