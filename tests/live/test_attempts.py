"""When a follower whose searches failed searches again."""

from __future__ import annotations

import pytest

from backhoe_planner.live.detours.attempts import Attempts


def failed(times: int, *, final: bool = False) -> Attempts:
    """After so many failures, one a second from 1 s on, for the surroundings 7."""
    attempts = Attempts()
    for number in range(times):
        attempts.note("a wall blocks the plan", 7, 1.0 + number, final=final)
    return attempts


@pytest.mark.parametrize(
    ("times", "again_after"), [(1, 0.0), (3, 0.0), (4, 1.0), (5, 2.0), (6, 4.0), (8, 16.0), (12, 16.0)]
)
def test_breaks_double_from_the_fourth_failure_on_up_to_16_s(times: int, again_after: float) -> None:
    attempts, last = failed(times), float(times)
    assert bool(attempts.blocked) == (again_after > 0.0)
    assert attempts.may_search(7, last + again_after)
    if again_after:
        assert not attempts.may_search(7, last + 0.99 * again_after)


def test_other_surroundings_are_searched_a_second_after_the_failure() -> None:
    attempts = failed(6)
    assert not attempts.may_search(8, 6.9)
    assert attempts.may_search(8, 7.1)


def test_if_no_effort_helps_the_plan_is_not_tried_again_for_the_same_surroundings() -> None:
    attempts = failed(1, final=True)
    assert attempts.blocked
    assert not attempts.may_retry(1e3)
    assert failed(4).may_retry(5.0)
    assert not failed(4).may_retry(4.9)


def test_beyond_the_place_where_it_was_stuck_the_machine_begins_anew() -> None:
    attempts = failed(5)
    attempts.begin(2.0)
    attempts.get_past(2.05)
    assert attempts.failed == 5
    attempts.get_past(2.2)
    assert attempts.failed == 0
    assert attempts.may_search(7, 0.0)


def test_a_failure_ahead_leaves_the_first_attempt_out() -> None:
    attempts = Attempts()
    attempts.note_ahead(3.0)
    assert attempts.failed == 1
    assert not attempts.blocked
    attempts.note_ahead(3.0)
    assert attempts.failed == 1


def test_a_machine_is_blocked_until_the_surroundings_change_or_the_plan_is_tried_again() -> None:
    assert not failed(3).blocks(7)
    attempts = failed(4)
    assert attempts.blocks(7)
    assert not attempts.blocks(8)
    attempts.retry()
    assert not attempts.blocks(7)
    attempts.begin(2.0)  # it leads nowhere: another search begins
    assert attempts.blocks(7)
    attempts.go_on()
    assert not attempts.blocks(7)
