"""The processes of a Dask cluster and who may speak to them."""
