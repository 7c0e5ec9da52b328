"""The three parts put together: started, shown, examined and compared."""

import os

# Matrices here are small: a second thread of the linear algebra only spins. Read when numpy is first
# imported, and inherited by every process that the testbed starts.
for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(_variable, "1")
