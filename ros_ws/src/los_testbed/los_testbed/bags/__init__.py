"""Bags: serialised messages, MCAP files, checks, repair, signatures."""
