"""Runs: processes, stages, replay, summaries."""
