"""A run for viewers while it goes on: recent samples, a Foxglove server, a page for browsers."""
