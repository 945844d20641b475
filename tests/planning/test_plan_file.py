"""The plan file and the exports: written whole or not at all, and checked anew when read."""

from __future__ import annotations

import csv
import json
import re
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest
import yaml
from reasons import comparison

import backhoe_planner as bp
from backhoe_planner.files.output_file import whole_file
from backhoe_planner.planning import EFFORTS, export_plan, plan_contradictions, plan_differences
from backhoe_planner.planning.search.effort import EffortName
from backhoe_planner.site import Obstruction

Data = dict[str, Any]
ROOT = Path(__file__).resolve().parents[2]
JOINTS = ("joint1", "joint2", "joint3", "joint4")


@pytest.fixture(scope="module")
def solved(planar4: bp.Robot) -> bp.Plan:
    """A short swing past a ball that has room to spare."""
    scene = bp.scene_from_dict(
        {
            "version": 1,
            "start": {"joints": {"joint1": 0.0, "joint2": 0.3, "joint3": 0.3, "joint4": 0.3}},
            "task": {"goal": {"position": [2.6, 2.4, 0.0]}},
            "obstacles": [{"name": "ball", "shape": "sphere", "radius": 0.3, "position": [-2.0, 2.0, 0.0]}],
        }
    )
    found = bp.plan(planar4, scene)
    assert found.verified, found.message
    return found


def saved(plan: bp.Plan, folder: Path) -> tuple[Path, Data]:
    file = folder / "plan.json"
    plan.save(file)
    content: Data = json.loads(file.read_text(encoding="utf-8"))
    return file, content


def test_changed_figures_and_bounds_in_a_file_are_computed_anew(solved: bp.Plan, tmp_path: Path) -> None:
    file, content = saved(solved, tmp_path)
    content["metrics"] |= {"duration": 0.1, "tip_length": 99.0, "energy": {"work": 1.0}}
    content["metrics"]["cost"]["value"] = 0.1
    content["bound"] |= {"duration": 50.0, "longer_percent": -90.0}
    file.write_text(json.dumps(content), encoding="utf-8")
    again = bp.load_plan(file)
    assert again.metrics == solved.metrics
    assert again.bound == solved.bound


def test_figures_of_a_file_that_differ_from_its_motion_are_reported_by_key(solved: bp.Plan, tmp_path: Path) -> None:
    file, content = saved(solved, tmp_path)
    assert plan_differences(file, bp.load_plan(file)) == []
    content["certificate"]["clearances"][0]["margin"] += 0.1
    content["certificate"]["limits"]["velocity"]["ratio"] = 0.5
    content["bound"]["duration"] *= 2.0
    content["metrics"]["planning_time"] = 77.0  # only planning knows it
    file.write_text(json.dumps(content), encoding="utf-8")
    told = plan_differences(file, bp.load_plan(file))
    assert [line.partition(":")[0] for line in told] == [
        "certificate.clearances[0].margin", "certificate.limits.velocity.ratio", "bound.duration",
    ]  # fmt: skip
    assert "the file says 0.5, the motions have " in told[1]
    content["dynamics"]["torque"] = [[1.0] * 4] * len(content["dynamics"]["torque"])
    file.write_text(json.dumps(content), encoding="utf-8")
    told = plan_differences(file, bp.load_plan(file))
    assert len(told) == 6
    assert re.fullmatch(r"and \d+ figures more", told[-1])


def test_repr_shows_a_plan_in_a_line(solved: bp.Plan) -> None:
    shown = rf"<Plan verified, {solved.trajectory.duration:.2f} s, margin \+\d\.\d{{3}} m between \w+ and [\w ()]+>"
    assert re.fullmatch(shown, repr(solved))


def test_parts_of_a_plan_are_shown_in_a_line_each(solved: bp.Plan) -> None:
    nearest = solved.certificate.clearances[0]
    assert repr(solved.certificate).startswith("<Certificate verified, margin +")
    assert repr(solved.certificate).endswith(f" m between {nearest.link} and {nearest.name}>")
    broken = replace(solved.certificate, problems=("the tip stops", "the rest"), clearances=())
    assert repr(broken) == "<Certificate not verified: the tip stops, and 1 more>"
    few = bp.Trajectory.from_steps(np.array([0.0, 0.5]), np.zeros((2, 4)))
    assert repr(few) == "<Trajectory: 2 samples of 4 joints, 0.50 s>"
    task = "path" if solved.problem.path else "goal"
    count = len(solved.problem.obstacles)
    assert repr(solved.problem) == f"<Problem of {solved.robot.name}: {task}, obstacles: {count}>"
    for obstacle in solved.problem.obstacles:
        assert repr(obstacle).startswith(f"<Obstacle {obstacle.name!r}: ")
    leg = bp.PlannedLeg("over", 0, 1, 1.0, solved.problem, few, solved.certificate, solved.metrics)
    assert repr(leg) == "<PlannedLeg 'over', verified, 1.00 to 1.50 s>"


def test_a_plan_is_the_same_after_saving_and_loading(solved: bp.Plan, tmp_path: Path) -> None:
    file, _ = saved(solved, tmp_path)
    again = bp.load_plan(file)
    assert again.verified
    for name in ("time", "q", "v"):
        np.testing.assert_array_equal(getattr(again.trajectory, name), getattr(solved.trajectory, name))
    assert again.certificate == solved.certificate
    assert again.scene.to_dict() == solved.scene.to_dict()
    assert (again.method, again.seed, again.message) == (solved.method, solved.seed, solved.message)
    assert again.effort == solved.effort == "normal"
    assert again.metrics == solved.metrics
    energy = solved.energy()
    assert energy.torque.shape == solved.trajectory.q.shape
    assert energy.work[-1] == pytest.approx(solved.metrics.energy["work"])
    other = tmp_path / "again.json"
    again.save(other)
    assert other.read_bytes() == file.read_bytes()


def test_the_file_holds_the_objective_with_its_value_and_unit(solved: bp.Plan, tmp_path: Path) -> None:
    _, content = saved(solved, tmp_path)
    assert solved.scene.objective is None  # to a goal, the default is time
    assert content["metrics"]["cost"] == {"objective": "time", "value": solved.trajectory.duration, "unit": "s"}
    scene = bp.scene_from_dict(solved.scene.to_dict() | {"objective": "velocity_norm"})
    cost = bp.plan(solved.robot, scene, effort="quick").metrics.cost
    assert cost is not None
    assert (cost.objective, cost.unit) == ("velocity_norm", "rad^2/s")


def test_a_file_without_an_effort_is_read(solved: bp.Plan, tmp_path: Path) -> None:
    file, content = saved(solved, tmp_path)
    assert content.pop("effort") == "normal"
    file.write_text(json.dumps(content), encoding="utf-8")
    again = bp.load_plan(file)
    assert again.verified
    assert (again.effort, again.settings) == (None, "method auto, seed 0")


def test_the_file_allows_the_efforts_of_the_planner() -> None:
    assert get_args(EffortName) == tuple(EFFORTS)


def test_the_file_has_the_keys_of_the_contract(solved: bp.Plan, tmp_path: Path) -> None:
    _, content = saved(solved, tmp_path)
    assert (content["format"], content["version"], content["verdict"]) == ("backhoe-planner/plan", 1, "verified")
    assert content["robot"]["joints"] == ["joint1", "joint2", "joint3", "joint4"]
    count = len(content["trajectory"]["time"])
    assert np.shape(content["trajectory"]["q"]) == np.shape(content["trajectory"]["v"]) == (count, 4)
    assert set(content["certificate"]["min_clearance"]) == {"value", "margin", "obstacle", "link", "time"}
    assert {"duration", "planning_time", "energy", "detour"} <= set(content["metrics"])


@pytest.mark.parametrize(
    ("keys", "value", "named"),
    [
        (["format"], "something else", "format"),
        (["version"], 7, "version"),
        (["robot"], None, "robot"),
        (["robot", "urdf"], 3, "robot.urdf"),
        (["scene"], [], "scene"),
        (["scene", "clearance"], -1.0, "scene"),
        (["trajectory"], "gone", "trajectory"),
        (["trajectory", "time"], None, "trajectory.time"),
        (["trajectory", "q"], [[0.0, 0.0], [0.0, 0.0]], "trajectory.q"),
        (["trajectory", "q", 0, 0], "a", "trajectory.q"),
        (["trajectory", "q", 0, 0], None, "trajectory.q"),
        (["trajectory", "time", 1], -1.0, "trajectory.time"),
        (["method"], "magic", "method"),
        (["verdict"], "perhaps", "verdict"),
        (["seed"], True, "seed"),
        (["seed"], -1, "seed"),
        (["version"], "1", "found '1'; allowed: 1"),
        (["effort"], "some", "effort: is not one of the allowed values; found 'some'; allowed: 'quick'"),
        (["metrics"], 1.0, "metrics"),
        (["metrics", "duration"], "long", "metrics.duration"),
        (["metrics", "duration"], 1e308, "metrics.duration: is 1e+308; allowed: at most 1e+30"),
        (["trajectory", "q", 0, 0], 1e308, "trajectory.q[0][0]: input should be less than or equal to 100000"),
        (["trajectory", "time", 1], 1e308, "trajectory.time[1]"),
        (["trajectory", "time", 1], 1e-300, "trajectory.time: samples lie too close together"),
        (["certificate", "limits", "position", "ratio"], "much", "certificate.limits.position.ratio"),
        (["certificate", "proven"], True, "certificate.proven: there is no such key"),
        (["findings", "waits"], "yes", "findings.waits"),
        (["reazon"], "", "reazon: there is no such key; did you mean 'reason'?"),
        (["reason"], "banana", "reason: is not one of the allowed values; found 'banana'; allowed: ''"),
        (["reason"], "blocked", "reason 'blocked' beside the verdict verified; allowed: no reason"),
        (["verdict"], "failed", "reason '' beside the verdict failed; allowed: a reason"),
    ],
)
def test_a_damaged_file_names_the_key(
    solved: bp.Plan, tmp_path: Path, keys: list[Any], value: object, named: str
) -> None:
    file, content = saved(solved, tmp_path)
    record: Any = content
    for key in keys[:-1]:
        record = record[key]
    record[keys[-1]] = value
    file.write_text(json.dumps(content), encoding="utf-8")
    with pytest.raises(bp.PlanFileError) as caught:
        bp.load_plan(file)
    assert str(file) in str(caught.value)
    assert named in str(caught.value)


@pytest.mark.parametrize("text", ["", "{", "[]", "null", '{"format": 1}'])
def test_a_file_of_another_kind_is_refused(tmp_path: Path, text: str) -> None:
    file = tmp_path / "plan.json"
    file.write_text(text, encoding="utf-8")
    with pytest.raises(bp.PlanFileError, match="is not a plan file" if text else "the file is empty; allowed: a plan"):
        bp.load_plan(file)


def test_a_missing_file_is_reported(tmp_path: Path) -> None:
    with pytest.raises(bp.PlanFileError, match="no such plan file"):
        bp.load_plan(tmp_path / "none.json")


def test_a_changed_urdf_is_noticed(solved: bp.Plan, tmp_path: Path) -> None:
    file, _ = saved(solved, tmp_path)
    urdf = tmp_path / "planar4.urdf"
    text = (ROOT / "models" / "planar4.urdf").read_text(encoding="utf-8")
    urdf.write_text(text, encoding="utf-8")
    assert bp.load_plan(file, urdf=urdf).verified
    urdf.write_text(text.replace('velocity="1.0"', 'velocity="1.1"'), encoding="utf-8")
    with pytest.raises(bp.RobotError) as caught:
        bp.load_plan(file, urdf=urdf)
    assert caught.value.key == "robot.sha256"


def test_a_shipped_model_is_saved_by_its_name(solved: bp.Plan, tmp_path: Path) -> None:
    file, content = saved(solved, tmp_path)
    assert content["robot"]["urdf"] == "example:planar4"
    assert bp.load_plan(file).verified


def test_a_plan_copied_without_its_urdf_reports_how_to_name_it(tmp_path: Path) -> None:
    site, elsewhere = tmp_path / "site", tmp_path / "elsewhere"
    site.mkdir()
    elsewhere.mkdir()
    urdf = site / "arm.urdf"
    shutil.copy(ROOT / "models" / "planar4.urdf", urdf)
    task = {"start": {"joints": dict.fromkeys(JOINTS, 0.3)}, "task": {"goal": {"position": [2.6, 2.4, 0.0]}}}
    file, content = saved(bp.plan(bp.load_robot(urdf), bp.scene_from_dict({"version": 1} | task)), site)
    assert content["robot"]["urdf"] == "arm.urdf"
    assert bp.load_plan(file).verified
    shutil.copy(file, elsewhere)
    with pytest.raises(bp.RobotError, match=r"arm\.urdf.*--urdf FILE"):
        bp.load_plan(elsewhere / file.name)
    assert bp.load_plan(elsewhere / file.name, urdf=urdf).verified


def test_a_file_with_only_the_keys_of_the_contract_is_a_plan(solved: bp.Plan, tmp_path: Path) -> None:
    file, content = saved(solved, tmp_path)
    kept = {"format", "version", "verdict", "reason", "message", "robot", "scene", "method", "seed", "trajectory"}
    least = {key: value for key, value in content.items() if key in kept}
    certificate, metrics = content["certificate"], content["metrics"]
    least["certificate"] = {
        "min_clearance": certificate["min_clearance"],
        "limits": certificate["limits"],
        "tip_error": {key: certificate["tip_error"][key] for key in ("max", "mean")},
    }
    least["metrics"] = {key: metrics[key] for key in ("duration", "planning_time", "energy")}
    least["metrics"]["detour"] = {key: metrics["detour"][key] for key in ("length", "max_deviation")}
    file.write_text(json.dumps(least), encoding="utf-8")
    again = bp.load_plan(file)
    assert again.verified
    assert again.certificate == solved.certificate


def test_an_older_file_with_details_instead_of_findings_is_read(solved: bp.Plan, tmp_path: Path) -> None:
    """`details` held figures of all kinds; the limit that the law breaks was a sentence."""
    file, content = saved(solved, tmp_path)
    del content["findings"]
    content["details"] = {"recorded": {"dt": 0.001, "notes": ["a"]}, "zones": [], "anything": {"else": 1}}
    del content["metrics"]["detours"]
    content["metrics"]["objective"] = {
        "name": "work", "value": 2.0, "law": 4.0, "saving_percent": 50.0, "whole": 3.0, "law_whole": 5.0,
        "saving_percent_whole": 40.0, "law_breaks": "limit of joint joint2",
    }  # fmt: skip
    file.write_text(json.dumps(content), encoding="utf-8")
    again = bp.load_plan(file)
    assert again.findings.recording is not None
    assert again.findings.recording.notes == ("a",)
    figures = comparison(again)
    assert figures.law_breaks == Obstruction.joint_limit("joint2")
    assert (figures.saving_percent, figures.saving_percent_whole) == pytest.approx((50.0, 40.0))


# --- the verdict --------------------------------------------------------------------


def test_the_certificate_alone_decides_that_a_plan_is_verified(solved: bp.Plan, tmp_path: Path) -> None:
    """Time ran out, and the motion found by then is proven: a verified plan with a message."""
    late = replace(solved, failure="budget", note="time ran out")
    assert (late.verdict, late.reason, late.message) == ("verified", "", "time ran out")
    file, content = saved(late, tmp_path)
    assert (content["verdict"], content["reason"], content["message"]) == ("verified", "", "time ran out")
    assert bp.load_plan(file).message == "time ran out"


def test_a_plan_whose_certificate_fails_is_not_verified(solved: bp.Plan, tmp_path: Path) -> None:
    tightest = Obstruction("obstacle", "ball", "link1", distance=0.01, margin=-0.04)
    broken = replace(solved.certificate, clearances=(tightest,), problems=("link1 comes too near", "and so on"))
    silent = replace(solved, certificate=broken)
    assert (silent.verdict, silent.reason, silent.message) == ("failed", "blocked", "link1 comes too near; and so on")
    over = replace(broken, velocity=replace(broken.velocity, ratio=1.5))
    assert replace(silent, certificate=over).reason == "outside_limits"
    late = replace(silent, failure="budget", note="time ran out")
    assert (late.verdict, late.reason, late.message) == ("failed", "budget", "time ran out")


def test_a_clear_motion_that_ends_off_the_goal_is_not_done_rather_than_blocked(solved: bp.Plan) -> None:
    """The same motion ends half a metre short of another goal, within all clearances and limits."""
    task = {"goal": {"position": [2.6, 2.9, 0.0]}}
    elsewhere = bp.scene_from_dict(solved.scene.to_dict() | {"task": task})
    short = replace(solved, certificate=bp.certify(solved.robot, elsewhere, solved.trajectory))
    assert (short.verdict, short.reason) == ("failed", "not_done")
    assert short.message == "the tip ends 0.500 m from the goal"


def test_the_verdict_of_a_file_is_proven_anew(solved: bp.Plan, tmp_path: Path) -> None:
    """The ball is moved into the motion in the file, which still says verified."""
    file, content = saved(solved, tmp_path)
    content["scene"]["obstacles"][0]["position"] = [1.0, 0.5, 0.0]
    file.write_text(json.dumps(content), encoding="utf-8")
    again = bp.load_plan(file)
    assert not again.verified
    assert not again.certificate.safe
    assert "ball" in again.message


def test_a_failure_that_the_motion_refutes_is_reported(solved: bp.Plan, tmp_path: Path) -> None:
    file = tmp_path / "plan.json"
    solved.save(file)
    assert plan_contradictions(file, bp.load_plan(file)) == []
    content = json.loads(file.read_text())
    file.write_text(json.dumps(content | {"verdict": "failed", "reason": "blocked", "message": "a wall"}))
    loaded = bp.load_plan(file)
    assert loaded.verified
    said = "verdict: the file says failed (blocked: a wall), but its motion is verified"
    assert plan_contradictions(file, loaded) == [said]
    # a motion that ends early is not verified, and its start is clear; nothing shows whether a search was blocked
    motion = {key: rows[:-5] for key, rows in content["trajectory"].items()}
    motion["v"][-1] = [0.0] * len(motion["v"][-1])
    for reason, found in (("start_in_collision", 1), ("blocked", 0)):
        file.write_text(json.dumps(content | {"verdict": "failed", "reason": reason, "trajectory": motion}))
        assert len(plan_contradictions(file, bp.load_plan(file))) == found


def test_an_edited_motion_is_not_verified(solved: bp.Plan, tmp_path: Path) -> None:
    """One sample in the middle jumps into the ball; the certificate in the file is left as it was."""
    file, content = saved(solved, tmp_path)
    rows = content["trajectory"]["q"]
    rows[len(rows) // 2] = [2.356, 0.0, 0.0, 0.0]
    file.write_text(json.dumps(content), encoding="utf-8")
    again = bp.load_plan(file)
    assert not again.verified
    assert again.certificate.min_clearance is not None
    assert again.certificate.min_clearance.obstacle == "ball"
    assert again.certificate.min_clearance.distance < 0.0


# --- writing ----------------------------------------------------------------------


def test_an_error_while_writing_leaves_the_old_file(tmp_path: Path) -> None:
    file = tmp_path / "kept.txt"
    file.write_text("old", encoding="utf-8")

    def fail() -> None:
        with whole_file(file) as stream:
            stream.write("half of the new")
            raise RuntimeError

    with pytest.raises(RuntimeError):
        fail()
    assert file.read_text(encoding="utf-8") == "old"
    assert list(tmp_path.iterdir()) == [file]


def test_a_file_appears_only_when_it_is_complete(tmp_path: Path) -> None:
    file = tmp_path / "new.txt"
    with whole_file(file) as stream:
        stream.write("text")
        assert not file.exists()
    assert file.read_text(encoding="utf-8") == "text"


def test_places_that_cannot_be_written_are_reported(
    solved: bp.Plan, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(bp.OutputError, match="does not exist"):
        solved.save(tmp_path / "none" / "plan.json")
    with pytest.raises(bp.OutputError, match="is a folder"):
        solved.save(tmp_path)
    monkeypatch.setattr("os.access", lambda *_args, **_keys: False)  # root may write anywhere
    with pytest.raises(bp.OutputError, match="may not be written"):
        solved.save(tmp_path / "plan.json")
    assert list(tmp_path.iterdir()) == []


# --- exports ----------------------------------------------------------------------


def test_csv_holds_the_motion(solved: bp.Plan, tmp_path: Path) -> None:
    file = tmp_path / "motion.csv"
    export_plan(solved, file)
    with file.open(newline="", encoding="utf-8") as stream:
        header, *rows = csv.reader(stream)
    names = [f"joint{j}" for j in range(1, 5)]
    tip = [f"tip.{name}" for name in ("x", "y", "z", "qw", "qx", "qy", "qz")]
    assert header == ["time", *(f"{n}.position" for n in names), *(f"{n}.velocity" for n in names), *tip]
    values = np.array(rows, dtype=float)
    motion = solved.trajectory
    np.testing.assert_array_equal(values[:, :-7], np.column_stack((motion.time, motion.q, motion.v)))
    np.testing.assert_allclose(values[:, -7:-4], solved.tip_path(), atol=1e-12)
    # the planar arm turns its tip about z by the sum of its joints
    half = 0.5 * motion.q.sum(axis=1)
    turned = np.column_stack((np.cos(half), 0.0 * half, 0.0 * half, np.sin(half)))
    np.testing.assert_allclose(np.abs(np.sum(values[:, -4:] * turned, axis=1)), 1.0, atol=1e-12)
    assert np.all(np.sum(values[1:, -4:] * values[:-1, -4:], axis=1) > 0.9)


def test_npz_holds_the_motion(solved: bp.Plan, tmp_path: Path) -> None:
    file = tmp_path / "motion.npz"
    export_plan(solved, file)
    with np.load(file) as arrays:
        for name in ("time", "q", "v"):
            np.testing.assert_array_equal(arrays[name], getattr(solved.trajectory, name))
        assert arrays["joints"].tolist() == list(solved.robot.joint_names)
        np.testing.assert_allclose(arrays["tip_position"], solved.tip_path(), atol=1e-12)
        np.testing.assert_allclose(np.linalg.norm(arrays["tip_quaternion"], axis=1), 1.0, atol=1e-12)


def test_yaml_holds_a_joint_trajectory(solved: bp.Plan, tmp_path: Path) -> None:
    file = tmp_path / "motion.yaml"
    export_plan(solved, file)
    message = yaml.safe_load(file.read_text(encoding="utf-8"))
    assert message["joint_names"] == list(solved.robot.joint_names)
    points, motion = message["points"], solved.trajectory
    np.testing.assert_array_equal([point["positions"] for point in points], motion.q)
    np.testing.assert_array_equal([point["velocities"] for point in points], motion.v)
    np.testing.assert_array_equal([point["accelerations"] for point in points], motion.accelerations())
    stamps = [point["time_from_start"] for point in points]
    assert all(isinstance(stamp["sec"], int) and 0 <= stamp["nanosec"] < 10**9 for stamp in stamps)
    np.testing.assert_allclose([s["sec"] + 1e-9 * s["nanosec"] for s in stamps], motion.time, atol=1e-9)


@pytest.mark.parametrize("name", ["plan.html", "plan.yaml", "plan.PNG"])
def test_a_plan_is_not_written_to_a_file_name_of_another_kind(solved: bp.Plan, tmp_path: Path, name: str) -> None:
    with pytest.raises(bp.OutputError, match=r"another kind of file than JSON; found \..*allowed: \.json"):
        solved.save(tmp_path / name)
    assert list(tmp_path.iterdir()) == []
    solved.save(tmp_path / "plan")
    assert (tmp_path / "plan").exists()


@pytest.mark.parametrize("name", ["motion.txt", "motion"])
def test_an_unknown_export_suffix_is_reported_with_those_allowed(solved: bp.Plan, tmp_path: Path, name: str) -> None:
    with pytest.raises(bp.OutputError, match=r"\.csv, \.npz, \.yaml"):
        export_plan(solved, tmp_path / name)
    assert list(tmp_path.iterdir()) == []


def test_a_plan_with_held_joints_is_read_with_the_same_joints(planar4: bp.Robot, tmp_path: Path) -> None:
    scene = bp.scene_from_dict(
        {
            "version": 1,
            "hold": {"joint2": 0.3},
            "start": {"joints": {"joint1": 0.0, "joint3": 0.3, "joint4": 0.3}},
            "task": {"goal": {"position": [2.2, 2.4, 0.0]}},
            "limits": {"velocity": {"joint1": 0.4}, "position": {"joint4": [-1.0, 1.0]}},
        }
    )
    plan = bp.plan(planar4, scene, effort="quick")
    assert plan.verified, plan.message
    plan.save(tmp_path / "plan.json")
    read = bp.load_plan(tmp_path / "plan.json")
    assert read.verified
    assert read.robot.joint_names == ("joint1", "joint3", "joint4")
    assert read.robot.hold == {"joint2": 0.3}
    np.testing.assert_array_equal(read.tip_path(), plan.tip_path())
    assert np.max(np.abs(read.trajectory.v[:, 0])) <= 0.4 + 1e-9
    content = json.loads((tmp_path / "plan.json").read_text())
    content["scene"]["hold"] = {"joint3": 0.3}
    (tmp_path / "other.json").write_text(json.dumps(content))
    with pytest.raises(bp.PlanFileError, match=r"robot.joints: .*found .*joint1.*allowed: joint1, joint2, joint4"):
        bp.load_plan(tmp_path / "other.json")
    content["scene"]["hold"] = {"joint7": 0.3}
    (tmp_path / "other.json").write_text(json.dumps(content))
    with pytest.raises(bp.PlanFileError, match=r"scene: hold: .*no such joint; found joint7"):
        bp.load_plan(tmp_path / "other.json")


@pytest.fixture(scope="module")
def there_and_back(planar4: bp.Robot) -> bp.Plan:
    legs = [
        {"name": "there", "goal": {"joints": dict.fromkeys(JOINTS, 0.4)}},
        {"name": "rest", "wait": 0.5},
        {"name": "back", "goal": {"joints": dict.fromkeys(JOINTS, 0.0)}},
    ]
    scene = {"version": 1, "start": {"joints": dict.fromkeys(JOINTS, 0.0)}, "task": {"sequence": legs}}
    return bp.plan(planar4, bp.scene_from_dict(scene), effort="quick")


@pytest.mark.parametrize(
    ("leg", "key", "off", "said", "allowed"),
    [
        (1, "begins", 0.5, "legs[1].begins: is not when this leg begins", "the time of its first sample"),
        (2, "begins", -1e-4, "legs[2].begins: is not when this leg begins", "the time of its first sample"),
        (1, "last", 1, "legs[1].last: is not the last sample of this leg", "the first of the next leg"),
        (2, "last", -1, "legs[2].last: is not the last sample of this leg", "the last"),
        (0, "first", 1, "legs[0].first: is no sample at which this leg can begin", "allowed: 0"),
        (2, "first", -40, "legs[2].first: is no sample at which this leg can begin", "allowed: "),
    ],
)
def test_a_leg_that_does_not_begin_or_end_at_its_samples_is_refused(
    there_and_back: bp.Plan, tmp_path: Path, leg: int, key: str, off: float, said: str, allowed: str
) -> None:
    file, content = saved(there_and_back, tmp_path)
    assert bp.load_plan(file).verified
    content["legs"][leg][key] += off
    file.write_text(json.dumps(content), encoding="utf-8")
    with pytest.raises(bp.PlanFileError) as refused:
        bp.load_plan(file)
    for words in (str(file), said, f"found {content['legs'][leg][key]}", allowed):
        assert words in str(refused.value)


def test_a_leg_that_is_moved_to_other_samples_is_refused(there_and_back: bp.Plan, tmp_path: Path) -> None:
    """Where it begins is said by its time as well."""
    file, content = saved(there_and_back, tmp_path)
    content["legs"][0]["last"] -= 3
    content["legs"][1]["first"] -= 3
    file.write_text(json.dumps(content), encoding="utf-8")
    with pytest.raises(bp.PlanFileError, match=re.escape("legs[1].begins: is not when this leg begins")):
        bp.load_plan(file)
