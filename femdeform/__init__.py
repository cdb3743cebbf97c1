"""Large-deformation simulation: what is simulated, and how a run is wired."""

import os

from femdeform.blas_threads import begin_with_one

# Idle threads of a BLAS wait busily, 2^26 cycles by default, and keep the kernels from the cores: after a single dot
# product of NumPy's, sweeps over a mesh take twice as long. 2^18 are 0.1 ms. Read when a BLAS is loaded.
os.environ.setdefault("OPENBLAS_THREAD_TIMEOUT", "18")
begin_with_one()
