"""Settings of a run and what is named in them: topics, members of a family, code of the user, exit codes."""
