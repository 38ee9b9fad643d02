"""Messages as bytes, between the nodes and the middleware."""
