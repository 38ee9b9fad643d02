"""Processes of a Dask cluster and their access control."""
