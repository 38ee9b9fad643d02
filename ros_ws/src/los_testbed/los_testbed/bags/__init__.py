"""Bags: messages as bytes, MCAP files, what a bag says about its run."""
