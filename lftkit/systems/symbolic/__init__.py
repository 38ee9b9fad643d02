"""Systems written as expressions of s and of uncertain parameters."""
