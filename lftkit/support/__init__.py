"""Processes, threads, progress and files."""
