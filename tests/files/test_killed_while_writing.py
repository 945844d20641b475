"""Whenever a writing process is killed, the old file or the new one exists, complete."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from waiting import PATIENCE

from backhoe_planner.files.output_file import whole_file

KILLED_AT_MANY_MOMENTS = """
import os, resource, signal, sys
from pathlib import Path

import backhoe_planner as bp
from backhoe_planner import live, show

folder = Path(sys.argv[1])
robot = bp.load_robot("example:planar4")
start = dict(zip(robot.joint_names, [0.3, 0.5, -0.4, 0.2]))
content = {"version": 1, "start": {"joints": start}, "task": {"goal": {"position": [1.0, 1.5, 0.0]}}}
scene = bp.scene_from_dict(content)
plan = bp.plan(robot, scene, effort="quick")
recording = live.plan_from_recording(robot, scene, plan.trajectory)
writers = {
    "plan.json": plan.save,
    "recording.json": recording.save,
    "page.html": lambda path: show.write_page(plan, path),
    "plot.svg": lambda path: show.plot_plan(plan, path),
}
old = b"the old file"
# killed when so many bytes are written, and before so many of the calls that open, change and rename files
moments = [("bytes", size) for size in (0, 511, 8192, 10_000)] + [("calls", count) for count in range(5)]
target, kill_at, found = None, None, []

def watch(event, args):
    global target, kill_at
    if event == "tempfile.mkstemp" and target is not None:
        written, target = target, None
        for what, amount in moments:
            child = os.fork()
            if child == 0:
                if what == "bytes":  # killed in the middle of a write
                    signal.signal(signal.SIGXFSZ, signal.SIG_DFL)
                    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
                    resource.setrlimit(resource.RLIMIT_FSIZE, (amount, amount))
                else:
                    kill_at = amount
                return
            _, status = os.waitpid(child, 0)
            found.append((os.WIFSIGNALED(status), written.read_bytes()))
            written.write_bytes(old)
    elif kill_at is not None and event in ("open", "os.chmod", "os.rename", "os.remove"):
        if kill_at == 0:
            os.kill(os.getpid(), signal.SIGKILL)
        kill_at -= 1

parent = os.getpid()
sys.addaudithook(watch)
for name, write in writers.items():
    target = path = folder / name
    target.write_bytes(old)
    found.clear()
    write(path)
    if os.getpid() != parent:
        os._exit(0)  # a child that was not killed
    new = path.read_bytes()
    assert len(new) > 10_000
    assert len(found) == len(moments)
    assert {content for _, content in found} <= {old, new}, f"half a file: {name}"
    assert sum(killed for killed, _ in found) >= 7, found
    rest = [one.name for one in folder.iterdir() if one.name not in writers]
    assert any(one.startswith(f".{name}.") and one.endswith(".part") for one in rest), rest
print("whole")
"""


@pytest.mark.long
def test_a_file_is_written_completely_or_not_at_all(tmp_path: Path) -> None:
    """Child processes are killed in the middle of writing, and between the calls that put the file in place.

    Their remains begin with a dot, end with .part, and disturb nothing.
    """
    done = subprocess.run(
        [sys.executable, "-c", KILLED_AT_MANY_MOMENTS, str(tmp_path)],
        capture_output=True, text=True, timeout=PATIENCE, check=False,
    )  # fmt: skip
    assert (done.returncode, done.stdout) == (0, "whole\n"), done.stderr


KILLED_AT_RANDOM = """
import os, random, signal, sys, time
from pathlib import Path

from backhoe_planner.files.output_file import whole_file

target, seeded = Path(sys.argv[1]), random.Random(0)
contents = ["a" * 300_000, "b" * 500_000]
target.write_text(contents[0])
for _ in range(30):
    child = os.fork()
    if child == 0:
        turn = 0
        while True:
            with whole_file(target) as stream:
                stream.write(contents[turn % 2])
            turn += 1
    time.sleep(seeded.uniform(0.0, 0.01))
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    assert target.read_text() in contents, "half a file"
with whole_file(target) as stream:
    stream.write("c")
assert target.read_text() == "c"
print("whole")
"""


def test_a_process_killed_at_a_random_time_leaves_a_complete_file(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-c", KILLED_AT_RANDOM, str(tmp_path / "file.json")],
        capture_output=True, text=True, timeout=PATIENCE, check=False,
    )  # fmt: skip
    assert (done.returncode, done.stdout) == (0, "whole\n"), done.stderr
    assert all(path.name.startswith(".file.json.") for path in tmp_path.iterdir() if path.name != "file.json")


@pytest.mark.parametrize("there", [True, False])
def test_writing_to_a_link_replaces_its_target(tmp_path: Path, there: bool) -> None:
    target, link = tmp_path / "target.txt", tmp_path / "link.txt"
    if there:
        target.write_text("old")
    link.symlink_to(target)
    with whole_file(link) as stream:
        stream.write("new")
    assert link.is_symlink()
    assert target.read_text() == "new"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["link.txt", "target.txt"]
