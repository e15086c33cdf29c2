"""BLAS on one thread: threads make none of our small matrices faster, and their number changes last digits."""

# Environment variables that BLAS reads when it is loaded.
ONE_THREAD = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
