"""Campaigns: many members of the telescope's family, on the processes of a Dask cluster."""
