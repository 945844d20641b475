"""The number of threads of numpy's linear algebra (BLAS): one is best for the small matrices here.

The matrices have some ten or hundred rows. By default BLAS starts a thread for each core, and the threads wait for
each other in loops that keep the cores busy: a plan then takes 1.5 times the processor time, and is no faster.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from types import MappingProxyType

ONE_THREAD: Mapping[str, str] = MappingProxyType(
    dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
)


def use_one_thread() -> None:
    """Give BLAS one thread in this process and its children, unless the environment sets the number.

    This must be called before numpy is loaded.
    """
    for name, count in ONE_THREAD.items():
        os.environ.setdefault(name, count)
