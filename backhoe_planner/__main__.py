"""`python -m backhoe_planner`, the same as `backhoe-planner`."""

from __future__ import annotations

import gc
import os
import signal
import sys
from types import FrameType
from typing import NoReturn

from backhoe_planner.blas import use_one_thread

_YOUNG = 20_000  # objects; the simplest plan makes 120,000 that nearly all stay, and takes 3 % longer with Python's 700
_INTERRUPTED = 128 + signal.SIGINT  # exit status, as shells give it to what Ctrl-C ended


def main() -> NoReturn:
    """Entry point of the command line. Ctrl-C also works before the command runs, and after."""
    catches = signal.getsignal(signal.SIGINT) is signal.default_int_handler
    if catches:
        signal.signal(signal.SIGINT, _end)
    use_one_thread()
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")  # else it reads what every installed package offers
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
        if "ompl" not in sys.modules:  # it complains of every object of its own that is left at the end
            gc.freeze()  # the system takes back all memory at once; looking for cycles in it costs 0.1 s


def _interrupt(_: int, frame: FrameType | None) -> None:
    """Raise KeyboardInterrupt; in the middle of an import, end at once.

    Some libraries take every exception during an import to mean that a part is not
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
