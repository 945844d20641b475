"""The threads of numpy's linear algebra (BLAS): one is the best for what is computed here.

Matrices have some ten or hundred rows. By default BLAS starts a thread for each core, and these wait for each other
in loops that keep the cores busy: a plan then takes half as much of the processor again, and no less time.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from types import MappingProxyType

ONE_THREAD: Mapping[str, str] = MappingProxyType(
    dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
)


def use_one_thread() -> None:
    """Give BLAS one thread in this process and its children, but where the environment says how many.

    It has to come before numpy is loaded.
    """
    for name, count in ONE_THREAD.items():
        os.environ.setdefault(name, count)
