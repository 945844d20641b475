"""`python -m backhoe_planner`, the same as `backhoe-planner`."""

from __future__ import annotations

import gc
import os
import signal
import sys
from types import FrameType
from typing import NoReturn

from backhoe_planner.blas import use_one_thread

# objects between two searches for cycles; the simplest plan makes 130,000, of which nearly all stay: with 20,000 it
# takes 6 % longer, with Python's default of 700 another 3 %
_YOUNG = 200_000
_INTERRUPTED = 128 + signal.SIGINT  # the exit status that shells report for a command ended by Ctrl-C


def main() -> NoReturn:
    """Entry point of the command line. Ctrl-C also works before and after the command runs."""
    catches = signal.getsignal(signal.SIGINT) is signal.default_int_handler
    if catches:
        signal.signal(signal.SIGINT, _end)
    use_one_thread()
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")  # otherwise pydantic scans all installed packages
    gc.set_threshold(_YOUNG, *gc.get_threshold()[1:])
    from backhoe_planner.cli import main as run

    try:
        if catches:
            signal.signal(signal.SIGINT, _interrupt)
        run()
    except KeyboardInterrupt:  # just before the command began, or just after it ended
        _end()
    finally:
        if catches:
            signal.signal(signal.SIGINT, _end)
        if "ompl" not in sys.modules:  # ompl complains about each of its objects that is left at the end
            gc.freeze()  # the system frees all memory at once; a search for cycles would take 0.1 s


def _interrupt(_: int, frame: FrameType | None) -> None:
    """Raise KeyboardInterrupt; in the middle of an import, end at once.

    Some libraries take any exception during an import to mean that an optional part is not
    installed, and would go on. Nothing is being written at that time.
    """
    while frame is not None:
        if frame.f_code.co_filename.startswith("<frozen importlib"):
            _end()
        frame = frame.f_back
    raise KeyboardInterrupt


def _end(*_: object) -> NoReturn:
    sys.stderr.write("interrupted\n")
    sys.stderr.flush()
    os._exit(_INTERRUPTED)


if __name__ == "__main__":
    main()
