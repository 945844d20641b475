"""While steps are timed, Python collects only new garbage, and afterwards all."""

from __future__ import annotations

import gc
import weakref
from collections.abc import Iterator

import pytest

from validation.step_times import collecting_only_new


class Ring:
    """Refers to itself, so that only the garbage collector removes it."""

    def __init__(self) -> None:
        self.itself = self


@pytest.fixture
def nothing_kept() -> Iterator[None]:
    """Python's garbage collection covers everything, as in a program that freezes nothing."""
    gc.unfreeze()
    yield
    gc.collect()
    gc.freeze()


@pytest.mark.long
@pytest.mark.parametrize("raised", [None, ValueError])
@pytest.mark.usefixtures("nothing_kept")
def test_earlier_garbage_is_collected_only_after_the_timing(raised: type[Exception] | None) -> None:
    """Otherwise OMPL lists what was never freed when Python ends."""
    old: Ring | None = Ring()
    seen = weakref.ref(old)
    try:
        with collecting_only_new():
            old = None
            new = weakref.ref(Ring())
            gc.collect()
            assert seen() is not None
            assert new() is None
            if raised is not None:
                raise raised
    except ValueError:
        pass
    gc.collect()
    assert seen() is None


@pytest.mark.long
def test_objects_frozen_before_the_timing_stay_frozen() -> None:
    before = gc.get_freeze_count()
    assert before > 0  # everything that exists before the first test
    with collecting_only_new():
        pass
    assert gc.get_freeze_count() >= before
