"""Tables of any format as arrays by name: CSV, Parquet, NumPy, MATLAB and HDF5."""
