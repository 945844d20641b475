"""`python -m backhoe_planner`, the same as `backhoe-planner`."""

from __future__ import annotations

import os
import signal
import sys
from types import FrameType
from typing import NoReturn

from backhoe_planner.blas import use_one_thread

_INTERRUPTED = 128 + signal.SIGINT  # exit status, as shells give it to what Ctrl-C ended


def main() -> NoReturn:
    """Entry point of the command line. Ctrl-C also works while Python is still importing."""
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, _interrupt)
    use_one_thread()
    from backhoe_planner.cli import main as run

    run()


def _interrupt(_: int, frame: FrameType | None) -> None:
    """Raise KeyboardInterrupt; in the middle of an import, end at once.

    Some libraries take every exception during an import to mean that a part is not
    installed, and would go on. Nothing is being written at that time.
    """
    while frame is not None:
        if frame.f_code.co_filename.startswith("<frozen importlib"):
            sys.stderr.write("interrupted\n")
            sys.stderr.flush()
            os._exit(_INTERRUPTED)
        frame = frame.f_back
    raise KeyboardInterrupt


if __name__ == "__main__":
    main()
