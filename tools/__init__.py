"""What people type: the command line, demo, report, spy, bench."""

import os

# One BLAS thread, said before numpy is loaded: with more, OpenBLAS spins on every core and a 5 ms
# fingerprint query takes 8, and now and then a second. Children inherit it.
for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(_name, "1")
