"""Many independent computations, called cases: in processes of this machine, in a job array, or on a dask cluster."""
