"""Figures are written whole, in the format that their suffix names."""

from __future__ import annotations

import re
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from backhoe_planner.errors import InputError, OutputError
from backhoe_planner.machine import BatchKinematics, Robot
from backhoe_planner.motion import SAMPLE_PERIOD, Trajectory, build_problem, limit_usage
from backhoe_planner.planning import Plan, measure_motion, plan
from backhoe_planner.proof import certify
from backhoe_planner.show import plot_envelope, plot_plan
from backhoe_planner.show.drawing.kept_parts import kept_parts
from backhoe_planner.show.drawing.timeline import timeline
from backhoe_planner.show.plots import plots
from backhoe_planner.show.plots.figure_file import new_figure, save_figure
from backhoe_planner.show.plots.plots import moments_to_draw, torques_to_draw, with_rests_apart
from backhoe_planner.site import scene_from_dict

START = [0.0, 0.4, -1.6, -0.9]
MAGIC = {".png": b"\x89PNG", ".svg": b"<?xml", ".pdf": b"%PDF"}


def a_plan(robot: Robot, *, samples: int = 40, name: str = "_a $1 \N{LATIN SMALL LETTER U WITH DIAERESIS}") -> Plan:
    part = np.linspace(0.0, 1.0, samples)[:, None] if samples > 1 else np.zeros((1, 1))
    q = np.array(START) + (10 * part**3 - 15 * part**4 + 6 * part**5) * np.array([0.6, 0.3, 0.2, 0.3])
    scene = scene_from_dict(
        {
            "version": 1,
            "name": name,
            "payload": 200.0,
            "task": {
                "path": {
                    "waypoints": [{"position": [2.9, 0.0, -1.07]}, {"position": [3.0, 1.5, 0.2]}],
                    "tolerance": 0.02,
                }
            },
            "obstacles": [{"name": name, "shape": "sphere", "radius": 0.3, "position": [3.0, -0.8, -1.0]}],
        }
    )
    trajectory = Trajectory.from_steps(4.0 * part[:, 0], q)
    certificate = certify(robot, scene, trajectory)
    problem = build_problem(robot, scene)
    return Plan(
        problem=problem, method="reactive", seed=0, trajectory=trajectory, certificate=certificate,
        metrics=measure_motion(problem, trajectory, certificate), failure="blocked",
    )  # fmt: skip


@pytest.mark.long
@pytest.mark.parametrize("suffix", [".png", ".pdf"])
def test_a_plan_is_plotted_in_every_format(backhoe: Robot, tmp_path: Path, suffix: str) -> None:
    file = tmp_path / f"plan{suffix.upper() if suffix == '.png' else suffix}"
    plot_plan(a_plan(backhoe), file)
    assert file.read_bytes().startswith(MAGIC[suffix])
    assert [path.name for path in tmp_path.iterdir()] == [file.name]


def test_labels_carry_units_and_names(backhoe: Robot, tmp_path: Path) -> None:
    import matplotlib as mpl

    with mpl.rc_context({"svg.fonttype": "none"}):
        plot_plan(a_plan(backhoe, name="_costs $5 or $6"), tmp_path / "plan.svg")
    text = (tmp_path / "plan.svg").read_text()
    assert "more, shorter)" not in text
    for label in (
        "joint angle [deg]",
        "joint rate [deg/s]",
        "margin [m]",
        "off the path [mm]",
        "limit used [%]",
        "power [kW]",
        "200 kg of payload",
    ):
        assert label in text
    assert text.count("_costs $5 or $6") >= 2  # title and legend
    assert "swing" in text
    assert "bucket" in text


def svg(plan: Plan, folder: Path) -> str:
    import matplotlib as mpl

    with mpl.rc_context({"svg.fonttype": "none"}):
        plot_plan(plan, folder / "plan.svg")
    return (folder / "plan.svg").read_text()


def test_a_plan_without_a_motion_is_plotted_as_its_reason_and_configuration(backhoe: Robot, tmp_path: Path) -> None:
    text = svg(replace(a_plan(backhoe, samples=1, name="ball"), note="the path is behind a wall"), tmp_path)
    assert "There is no motion: the path is behind a wall" in text
    assert "stick  -91.67 deg" in text  # -1.6 rad
    assert "ball" in text
    for absent in ("time [s]", "power", "joint rate"):
        assert absent not in text


@pytest.mark.long
def test_the_plot_of_a_motion_that_ends_early_gives_the_reason(backhoe: Robot, tmp_path: Path) -> None:
    text = svg(replace(a_plan(backhoe), note="a wall is in the way"), tmp_path)
    assert "The motion ends before its task is done: a wall is in the way" in text
    assert "time [s]" in text


@pytest.mark.long
def test_kept_ranges_have_a_panel_for_each_unit(backhoe: Robot, tmp_path: Path) -> None:
    plan = a_plan(backhoe)
    content = plan.scene.to_dict()
    content["task"]["keep"] = {"pitch": [-2.3, -1.1], "above": -2.0, "below": 4.0}
    text = svg(replace(plan, problem=build_problem(backhoe, scene_from_dict(content))), tmp_path)
    for words in ("left to keep [deg]", "left to keep [m]", "-131.8 to -63.03 deg", "at least -2 m", "at most 4 m"):
        assert words in text


def test_what_a_single_leg_keeps_has_a_curve_over_that_leg_alone(backhoe: Robot, tmp_path: Path) -> None:
    start = {"swing": 0.0, "boom": 0.4, "stick": -1.6, "bucket": -0.9}
    legs = [
        {"name": "out", "goal": {"joints": start | {"swing": 0.3}}},
        {"name": "level", "goal": {"joints": start | {"swing": 0.6}}, "keep": {"pitch": [-2.3, -1.9]}},
    ]
    scene = scene_from_dict({"version": 1, "start": {"joints": start}, "task": {"sequence": legs}})
    found = plan(backhoe, scene, effort="quick")
    assert found.verified, found.message
    text = svg(found, tmp_path)
    assert "left to keep [deg]" in text
    assert "-131.8 to -108.9 deg" in text
    (before, ends, nothing), (begins, _, conditions) = kept_parts(found)
    assert before == 0.0
    assert ends == begins == found.legs[1].begins
    assert [len(nothing), [one.name for one in conditions]] == [0, ["pitch"]]


def test_the_limit_used_has_no_gaps_between_the_samples_of_a_smooth_motion(panda: Robot) -> None:
    """One joint speeds up from rest at its limit of acceleration all the time."""
    joints = dict.fromkeys(panda.joint_names, 0.0) | {"panda_joint4": -1.5, "panda_joint6": 1.5}
    task = {"goal": {"joints": joints}}
    problem = build_problem(panda, scene_from_dict({"version": 1, "start": {"joints": joints}, "task": task}))
    joint = 4
    acceleration = problem.limits.acceleration[joint]
    count = int(0.9 * problem.limits.velocity[joint] / acceleration / SAMPLE_PERIOD)
    time = np.arange(count + 1, dtype=np.float64) * SAMPLE_PERIOD
    q = np.tile([joints[name] for name in panda.joint_names], (count + 1, 1))
    q[:, joint] = 0.5 * acceleration * time**2 - 1.0
    smooth = Trajectory.from_steps(time, q)
    usage = limit_usage(problem, smooth)
    assert len(usage.moments.time) > len(time)  # it is fast enough for moments between samples
    assert usage.greatest[1:-1].min() > 0.99
    drawn = moments_to_draw(smooth, usage.moments)
    np.testing.assert_allclose(usage.moments.time[drawn], time)
    assert usage.greatest[drawn][1:-1].min() > 0.99

    far = Trajectory.from_steps(time[::8], q[::8])  # these samples are corners, and nothing is used between them
    assert moments_to_draw(far, far.moments()).all()


def test_the_limit_used_in_a_rest_is_that_of_the_machine_at_rest(backhoe: Robot) -> None:
    """A swing stops, rests for 2 s with only the weight to hold, and starts again."""
    joints = dict(zip(backhoe.joint_names, START, strict=True))
    content = {"version": 1, "start": {"joints": joints}, "task": {"goal": {"position": [2.9, 0.0, -1.07]}}}
    problem = build_problem(backhoe, scene_from_dict(content))
    start, turned = np.array(START), np.array(START) + np.array([0.01, 0.0, 0.0, 0.0])
    time = np.array([0.0, SAMPLE_PERIOD, 2.0 + SAMPLE_PERIOD, 2.0 + 2.0 * SAMPLE_PERIOD])
    stopping = Trajectory.from_steps(time, np.array([start, turned, turned, start]))
    apart = with_rests_apart(stopping)
    np.testing.assert_allclose(apart.time[[0, 1, 4, 5]], time)
    np.testing.assert_array_equal(apart.q[[0, 1, 4, 5]], stopping.q)
    assert with_rests_apart(replace(stopping, begins=(0, 1, 2))).begins == (0, 1, 4)
    held = limit_usage(problem, Trajectory.from_steps(np.array([0.0, 1.0]), np.array([turned, turned]))).greatest
    usage = limit_usage(problem, apart)
    drawn = moments_to_draw(apart, usage.moments)
    np.testing.assert_allclose(usage.greatest[drawn][2:4], held[0])
    assert usage.greatest[drawn][1] > 2.0 * held[0]


def test_the_torques_of_a_leg_are_drawn_up_to_its_end(backhoe: Robot) -> None:
    """A load is held through a wait of 2 s and gone after it: the torque is constant, and then falls at once."""
    joints = dict(zip(backhoe.joint_names, START, strict=True))
    turned = np.array(START) + np.array([0.01, 0.0, 0.0, 0.0])
    there = {"joints": dict(zip(backhoe.joint_names, turned.tolist(), strict=True))}
    legs = [{"name": "hold", "wait": 2.0, "payload": 400.0}, {"name": "go", "goal": there}]
    content = {"version": 1, "start": {"joints": joints}, "task": {"sequence": legs}}
    problem = build_problem(backhoe, scene_from_dict(content))
    motion = Trajectory.from_steps(np.array([0.0, 2.0, 3.0]), np.array([START, START, turned]))
    time, torque = torques_to_draw(problem, replace(motion, begins=(0, 1)))
    held = torque[time < 2.0]
    assert len(held) == 3  # the beginning, and a period from both ends
    np.testing.assert_allclose(held, np.broadcast_to(held[0], held.shape))
    boom = backhoe.joint_names.index("boom")
    # the axis of the boom is 0.535 m before that of the swing
    (tip,) = BatchKinematics(problem.robot).tip_positions(np.array([START]))
    before, after = torque[time == 2.0]
    assert before[boom] == pytest.approx(held[0, boom], rel=1e-3)
    fall = before[boom] - after[boom]
    assert fall == pytest.approx(400.0 * 9.81 * (tip[0] - 0.535), rel=0.01)


def test_limits_that_the_legend_does_not_name_are_counted(
    backhoe: Robot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from matplotlib.figure import Figure
    from matplotlib.text import Text

    monkeypatch.setattr(plots, "_BINDS", 0.0)  # whatever is used most binds
    monkeypatch.setattr(plots, "_MOST_NAMED", 1)
    made: list[Figure] = []  # drawing it takes four times as long as making it, and changes no text
    monkeypatch.setattr(plots, "save_figure", lambda figure, *_, **__: made.append(figure))
    plot_plan(a_plan(backhoe), tmp_path / "plan.svg")
    texts = [text.get_text() for text in made[0].findobj(Text)]
    assert any(re.search(r"\([1-9] more, shorter\)", text) for text in texts)


def test_labels_beside_panels_stand_in_one_line_left_of_the_longest_number(tmp_path: Path) -> None:
    file = tmp_path / "figure.svg"
    figure = new_figure(file, 5.0, 4.0, inputs=())
    panels = list(figure.subplots(3, 1))
    for axes, largest in zip(panels, (1.0, 123456.0, 1e-4), strict=True):
        axes.plot([0.0, 1.0], [-largest, largest])
        axes.set_ylabel("value")
    save_figure(figure, file, "title", panels=panels)
    figure.draw_without_rendering()
    labels = [axes.yaxis.label.get_window_extent() for axes in panels]
    numbers = [text.get_window_extent() for axes in panels for text in axes.get_yticklabels()]
    assert np.ptp([label.x1 for label in labels]) < 0.5  # pixels
    assert max(label.x1 for label in labels) < min(number.x0 for number in numbers)
    assert min(label.x0 for label in labels) > 0.0


@pytest.mark.parametrize("name", ["plan.jpg", "plan", "plan.json"])
def test_an_unknown_suffix_is_an_error_that_names_the_allowed_ones(backhoe: Robot, tmp_path: Path, name: str) -> None:
    with pytest.raises(OutputError, match=r"\.png, \.svg, \.pdf"):
        plot_plan(a_plan(backhoe), tmp_path / name)
    with pytest.raises(OutputError, match=r"\.png, \.svg, \.pdf"):
        plot_envelope(backhoe, tmp_path / name)
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_does_not_exist_is_an_error(backhoe: Robot, tmp_path: Path) -> None:
    with pytest.raises(OutputError, match="does not exist"):
        plot_plan(a_plan(backhoe), tmp_path / "nowhere" / "plan.svg")


def test_the_envelope_has_the_data_sheets_figures(backhoe: Robot, tmp_path: Path) -> None:
    import matplotlib as mpl

    with mpl.rc_context({"svg.fonttype": "none"}):
        plot_envelope(backhoe, tmp_path / "reach.svg")
    text = (tmp_path / "reach.svg").read_text()
    for figure in ("digging depth 4.38 m", "reach at ground level 5.65 m", "loading height 3.61 m"):
        assert figure in text


@pytest.mark.long
def test_the_envelope_of_a_planar_arm_is_plotted(planar4: Robot, tmp_path: Path) -> None:
    plot_envelope(planar4, tmp_path / "reach.png")
    assert (tmp_path / "reach.png").read_bytes().startswith(MAGIC[".png"])


def test_the_envelope_of_a_tip_that_only_swings_is_plotted_from_above(backhoe: Robot, tmp_path: Path) -> None:
    """The boom's own frame is at its pin, which moves on a circle, with no extent in the plane of the arm."""
    import matplotlib as mpl

    with mpl.rc_context({"svg.fonttype": "none"}):
        plot_envelope(backhoe.with_tip("boom"), tmp_path / "pin.svg")
    text = (tmp_path / "pin.svg").read_text()
    assert "from above" in text
    assert "digging depth" not in text


def test_without_matplotlib_the_extra_is_named(backhoe: Robot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(InputError, match=r'pip install "backhoe_planner\[plots\]"'):
        plot_envelope(backhoe, tmp_path / "envelope.png")
    assert not list(tmp_path.iterdir())


def test_the_axis_of_margins_ends_above_the_greatest_one(backhoe: Robot) -> None:
    """Not at twice the distance at which obstacles act, which left most of the panel empty."""
    from matplotlib.figure import Figure

    plan = a_plan(backhoe)
    axes = Figure().subplots()
    plots._clearance(axes, plan, plan.problem, timeline(plan.problem, plan.trajectory))
    greatest = max(float(np.nanmax(line.get_ydata())) for line in axes.lines)
    assert greatest < axes.get_ylim()[1] <= max(1.13 * greatest, 0.2 * plan.scene.influence)
