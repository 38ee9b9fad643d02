"""Live view of a run: recent samples, a Foxglove server, a page for browsers."""
