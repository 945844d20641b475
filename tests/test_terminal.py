"""What the commands print while something takes long: moving lines on a terminal, plain lines in a log."""

from __future__ import annotations

import time

import pytest

from backhoe_planner.cli import terminal
from backhoe_planner.cli.terminal import Stream


def test_a_log_has_a_line_soon_after_the_beginning_and_then_now_and_then(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(terminal, "_FIRST_LINE", 0.01)
    monkeypatch.setattr(terminal, "_NEXT_LINE", 0.02)
    said = ""
    with Stream("stderr").status("planning ...") as status:
        assert status is not None
        begun = time.monotonic()
        while said.count("(0 s)") < 2 and time.monotonic() < begun + 5.0:
            time.sleep(0.01)
            said += capsys.readouterr().err
        status.update("proving ...")
        while "proving" not in said and time.monotonic() < begun + 5.0:
            time.sleep(0.01)
            said += capsys.readouterr().err
    assert said.splitlines()[:2] == ["planning ... (0 s)"] * 2
    assert "proving ... (0 s)" in said.splitlines()
    time.sleep(0.05)
    assert capsys.readouterr().out == ""


def test_what_is_over_soon_or_is_to_be_quiet_leaves_no_line(capsys: pytest.CaptureFixture[str]) -> None:
    with Stream("stderr").status("planning ..."):
        pass
    with Stream("stderr").status("planning ...", quiet=True) as status:
        assert status is None
    assert capsys.readouterr() == ("", "")
