"""Settings of a run: topics, members of a family, user code, exit codes."""
