"""An interrupted or killed campaign resumes and ends with the results of an undisturbed one."""

from __future__ import annotations

import itertools
import subprocess
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path

import pytest
from cases import Part, die_at_three, divisors, square

import backhoe_planner as bp
from validation import campaigns
from validation.campaigns import Campaign, call_for_all


@pytest.fixture
def calls(tmp_path: Path) -> Path:
    """A folder with a file for every call of `square`."""
    folder = tmp_path / "calls"
    folder.mkdir()
    return folder


def called(calls: Path) -> list[int]:
    return sorted(int(file.name.partition("-")[0]) for file in calls.iterdir())


def test_an_interrupted_campaign_resumes_with_its_kept_results(tmp_path: Path, calls: Path) -> None:
    call, kept = partial(square, calls=calls), tmp_path / "kept"

    def stop(done: int, _: Part) -> None:
        if done == 3:
            raise KeyboardInterrupt

    found, interrupted = call_for_all(call, range(5), result=Part, jobs=1, folder=kept, watch=stop)
    assert (interrupted, [one.number for one in found]) == (True, [0, 1, 4])
    assert called(calls) == [0, 1, 2]
    told: list[tuple[int, int]] = []
    with pytest.warns(UserWarning, match="3 cases were done by an earlier run; to begin anew, remove "):
        found, interrupted = call_for_all(
            call, range(5), result=Part, jobs=1, folder=kept, watch=lambda done, one: told.append((done, one.number))
        )
    assert called(calls) == [0, 1, 2, 3, 4], "none twice"
    assert (interrupted, told) == (False, [(1, 0), (2, 1), (3, 4), (4, 9), (5, 16)])
    undisturbed, _ = call_for_all(call, range(5), result=Part, jobs=1)
    assert repr(found) == repr(undisturbed), "as text, since nan is not nan"
    assert list(kept.iterdir()) == [], "what is done is not kept"


def test_a_killed_campaign_loses_at_most_its_current_case(tmp_path: Path, calls: Path) -> None:
    """The process of the campaign itself ends abruptly after the second case."""
    code = f"""
import os
from collections.abc import Callable
from functools import partial
from pathlib import Path
from cases import Part, square
from validation.campaigns import call_for_all
call_for_all(partial(square, calls=Path({str(calls)!r})), range(4), result=Part, jobs=1, folder=Path({str(tmp_path)!r}),
             watch=lambda done, _: os._exit(9) if done == 2 else None)
"""
    root = Path(__file__).resolve().parents[2]
    path = ":".join([str(root), str(Path(__file__).parent)])
    ended = subprocess.run([sys.executable, "-c", code], env={"PYTHONPATH": path}, check=False)
    assert ended.returncode == 9
    with pytest.warns(UserWarning, match="2 cases were done"):
        found, _ = call_for_all(partial(square, calls=calls), range(4), result=Part, jobs=1, folder=tmp_path)
    assert [one.number for one in found] == [0, 1, 4, 9]
    assert called(calls) == [0, 1, 2, 3]


def test_other_settings_or_other_code_make_another_campaign(
    tmp_path: Path, calls: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def stop(*_: object) -> None:
        raise KeyboardInterrupt

    def run(folder: Path) -> None:
        call_for_all(partial(square, calls=folder), [1, 2], result=Part, jobs=1, folder=tmp_path / "kept", watch=stop)

    run(calls)
    (tmp_path / "other").mkdir()
    run(tmp_path / "other")
    assert (called(calls), called(tmp_path / "other")) == ([1], [1])
    monkeypatch.setattr(campaigns, "_CODE", ("tests/validation/cases.py",))
    run(calls)
    assert called(calls) == [1, 1]
    assert len(list((tmp_path / "kept").iterdir())) == 3


@pytest.mark.long
def test_the_first_results_equal_those_of_sequential_calls(tmp_path: Path) -> None:
    """The numbers with divisors, 4, 6, 8, 9, 10, ..., give one or two each."""
    for count, jobs in ((1, 1), (5, 1), (6, 2)):
        with Campaign(divisors, list[int], jobs=jobs, folder=tmp_path) as campaign:
            found = campaign.first(itertools.count(1), count, most=2)
        assert found == [2, 2, 3, 2, 4, 3][:count]
        assert not campaign.interrupted
    with Campaign(divisors, list[int], jobs=1) as campaign:
        assert campaign.first(iter([4, 5]), 7) == [2], "no more cases"


@pytest.mark.long
def test_a_case_that_kills_its_process_gets_the_died_result_and_is_not_repeated(tmp_path: Path) -> None:
    def stop(done: int, _: int) -> None:
        if done == 3:
            raise KeyboardInterrupt

    def run(watch: Callable[[int, int], object] = lambda *_: None) -> list[int]:
        return call_for_all(
            die_at_three, [2, 3, 4, 5], result=int, jobs=2, folder=tmp_path, died=lambda case: -case, watch=watch
        )[0]

    assert set(run(stop)) <= {2, -3, 4, 5}
    with pytest.warns(UserWarning, match="3 cases were done"):
        assert run() == [2, -3, 4, 5]
    with pytest.warns(UserWarning, match="the process died twice at 3"):
        assert call_for_all(die_at_three, [3, 4], result=int, jobs=2)[0] == [4]


def test_a_campaign_cannot_run_twice_at_a_time(tmp_path: Path, calls: Path) -> None:
    call = partial(square, calls=calls)
    with (
        Campaign(call, Part, jobs=1, folder=tmp_path),
        pytest.raises(bp.StudyError, match="another run writes its results here"),
        Campaign(call, Part, jobs=1, folder=tmp_path),
    ):
        pass


def test_a_case_without_a_full_description_is_refused(tmp_path: Path) -> None:
    with Campaign(str, str, jobs=1, folder=tmp_path) as campaign, pytest.raises(TypeError):
        campaign.run([object()])
