"""While steps are timed, Python looks for garbage only among what is new, and afterwards among all."""

from __future__ import annotations

import gc
import weakref
from collections.abc import Iterator

import pytest

from validation.step_times import collecting_only_new


class Ring:
    """Refers to itself, so that only a collection ends it."""

    def __init__(self) -> None:
        self.itself = self


@pytest.fixture
def nothing_kept() -> Iterator[None]:
    """Python searches through everything for garbage, as in a program that keeps nothing out of it."""
    gc.unfreeze()
    yield
    gc.collect()
    gc.freeze()


@pytest.mark.long
@pytest.mark.parametrize("raised", [None, ValueError])
@pytest.mark.usefixtures("nothing_kept")
def test_what_was_there_before_is_collected_after_the_time_is_taken_alone(raised: type[Exception] | None) -> None:
    """Else OMPL, when Python ends, lists what was never given back."""
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


def test_what_was_kept_out_of_the_search_before_stays_out_of_it() -> None:
    before = gc.get_freeze_count()
    assert before > 0  # all that is there before the first test
    with collecting_only_new():
        pass
    assert gc.get_freeze_count() >= before
