"""Figures of a plan over time."""

from __future__ import annotations

import os
import textwrap
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from backhoe_planner.arrays import Vector
from backhoe_planner.digits import margin_text
from backhoe_planner.motion import (
    SAMPLE_PERIOD,
    Moments,
    Problem,
    Trajectory,
    leg_parts,
    limit_usage,
    trajectory_energy,
)
from backhoe_planner.planning import Plan, compare_with_law, describe_saving
from backhoe_planner.show.drawing.kept_parts import kept_parts
from backhoe_planner.show.drawing.palette import PLOT_CYCLE
from backhoe_planner.show.drawing.timeline import Timeline, timeline
from backhoe_planner.show.plots.figure_file import dress, new_figure, plain_text, save_figure, say_above
from backhoe_planner.show.plots.leg_names import name_legs
from backhoe_planner.show.plots.posture_plot import draw_posture, posture_heights

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.lines import Line2D


_Panel = Callable[["Axes", Plan, Problem, Timeline], None]

_WIDTH, _PANEL = 9.5, 2.15  # inches: chosen, a page's width, and a panel's height
_TITLE_ABOVE = 6.0  # pt from a panel to the text above it: matplotlib's own
_PANEL_PART = 0.74  # of the figure's width that a panel has next to labels and legend; measured 0.76, reduced a little
_FAINT = 0.35  # opacity of limits; chosen
_STRIP = 0.55  # height of the panel of limits as part of a panel's height; chosen, it shows few numbers
_BINDS = 0.98  # part of a limit from which it is called binding: sampled accelerations are known to about 1 %
_MOST_NAMED = 5  # limits: as many as fit next to the panel
_DASHES = (0, (5, 4))  # points drawn and left out in the lines of limits
_WRONG = "#b3261e"
_LETTERS = 115  # per line above the panels: as many as fit
_SHARED = {"pump flow": "#5f6b76", "engine power": "#b3261e", "tip speed": "#1d2731"}
_HATCHES = {"acceleration": "////", "torque": "xxxx", "rod speed": "...."}


def plot_plan(plan: Plan, path: str | os.PathLike[str]) -> None:
    """Write a figure of a plan over time: joints, rates, clearance, torques, the binding limit, power and work.

    For a task along a path, it also shows the tip's distance from the path and the local law's work; if the task has a
    `keep`, the remaining margin. For a plan that failed it says why. If there is no motion, the figure shows the
    posture at the start instead, within the joint ranges and next to the obstacles.

    Parameters
    ----------
    path: path of the figure; .png, .svg or .pdf.

    Raises
    ------
    OutputError: another suffix, the folder cannot be written, or the file belongs to the machine or the scene.
    InputError: matplotlib is not installed.
    """
    figure = new_figure(path, _WIDTH, _PANEL, inputs=plan.input_files)
    problem = plan.problem
    frames = timeline(problem, plan.trajectory)
    verdict = "verified" if plan.verified else f"failed: {plan.reason.replace('_', ' ')}"
    title = f"{plain_text(plan.scene.title)}: {verdict} ({plan.settings})"
    if plan.trajectory.duration == 0.0:
        heights = posture_heights(problem, frames)
        figure.set_size_inches(_WIDTH, sum(heights) + 0.9)
        standing = figure.subplots(len(heights), 1, squeeze=False, height_ratios=heights)[:, 0]
        for axes in standing:
            dress(axes)
        draw_posture(list(standing), plan, problem, frames)
        _explain(standing[0], plan, "There is no motion: ")
        save_figure(figure, path, title)
        return
    panels: list[_Panel] = []
    slides = plan.robot.prismatic
    for which, unit, name in ((~slides, np.degrees(1.0), "angle [deg"), (slides, 1.0, "slide [m")):
        if np.any(which):
            panels.append(partial(_positions, which=which, unit=unit, label=f"joint {name}]"))
            panels.append(partial(_velocities, which=which, unit=unit, label=f"joint rate [{name.split('[')[1]}/s]"))
    if frames.obstacles:
        panels.append(_clearance)
    kept = [one for _, _, conditions in kept_parts(plan) for one in conditions]
    panels += [partial(_kept, unit=unit) for unit in ("rad", "m") if any(one.unit == unit for one in kept)]
    if problem.path is not None:
        panels.append(_deviation)
    panels += [_torques, _limits, _power]
    heights = [_STRIP if panel is _limits else 1.0 for panel in panels]
    figure.set_size_inches(_WIDTH, _PANEL * sum(heights) + 0.9)
    figure.set_layout_engine("constrained", hspace=0.06)
    all_axes = figure.subplots(len(panels), 1, sharex=True, squeeze=False, height_ratios=heights)[:, 0]
    for axes, panel in zip(all_axes, panels, strict=True):
        dress(axes)
        panel(axes, plan, problem, frames)
        axes.yaxis.label.set_size(9)
        for leg in plan.legs:
            axes.axvline(leg.begins, color="0.6", linewidth=0.8, zorder=0.5)
    named = name_legs(all_axes[0], plan, width=_PANEL_PART * _WIDTH * 72.0)
    all_axes[-1].set_xlabel("time [s]", fontsize=9)
    all_axes[-1].set_xlim(plan.trajectory.time[0], plan.trajectory.time[-1])
    _explain(all_axes[0], plan, "The motion ends before its task is done: " if plan.failure else "", above=named)
    save_figure(figure, path, title, panels=list(all_axes))


def _explain(axes: Axes, plan: Plan, what: str, *, above: float = 0.0) -> None:
    """Say above all panels why a plan failed, if it did. `above`: height of the text that is already there [pt]."""
    if plan.verified:
        return
    words = textwrap.fill(plain_text(f"{what}{plan.message}"), _LETTERS)
    below = axes.get_title("left")
    colour = _WRONG if not below else "black"
    say_above(axes, f"{words}\n\n{below}", loc="left", fontsize=9.5, color=colour, pad=max(above, _TITLE_ABOVE))


def _positions(
    axes: Axes, plan: Plan, problem: Problem, frames: Timeline, *, which: NDArray[np.bool_], unit: float, label: str
) -> None:
    axes.set_ylabel(label)
    for joint in np.flatnonzero(which):
        colour = _colour(int(joint))
        _curve(axes, plan.trajectory.time, unit * plan.trajectory.q[:, joint], colour, plan.robot.joint_names[joint])
        for limit in (problem.limits.lower[joint], problem.limits.upper[joint]):
            if np.isfinite(limit):
                axes.axhline(unit * limit, color=colour, alpha=_FAINT, linewidth=0.9, linestyle=_DASHES)
    _legend(axes)
    _say(axes, "dashed: limits")


def _velocities(
    axes: Axes, plan: Plan, problem: Problem, frames: Timeline, *, which: NDArray[np.bool_], unit: float, label: str
) -> None:
    axes.set_ylabel(label)
    time = plan.trajectory.time
    if len(time) > 1:
        steps = plan.trajectory.segment_velocities()
        # a rate holds from sample to sample: draw a line through the middles of short intervals, level in long ones
        inside = np.minimum(0.5 * np.diff(time), 0.5 * SAMPLE_PERIOD)
        moments = np.column_stack((time[:-1] + inside, time[1:] - inside)).ravel()
        for joint in np.flatnonzero(which):
            axes.plot(moments, unit * np.repeat(steps[:, joint], 2), color=_colour(int(joint)), linewidth=1.6)
    for joint in np.flatnonzero(which):
        for sign in (-1.0, 1.0):
            limit = sign * unit * problem.limits.velocity[joint]
            axes.axhline(limit, color=_colour(int(joint)), alpha=_FAINT, linewidth=0.9, linestyle=_DASHES)


def _clearance(axes: Axes, plan: Plan, problem: Problem, frames: Timeline) -> None:
    influence = plan.scene.influence
    lowest, highest, far = 0.0, 0.2 * influence, 0
    for index, name in enumerate(frames.obstacles):
        margin = frames.margins(index)
        if np.all(np.isnan(margin)) or np.nanmin(margin) > 2.0 * influence:
            far += 1
            continue
        lowest, highest = min(lowest, float(np.nanmin(margin))), max(highest, 1.12 * float(np.nanmax(margin)))
        _curve(axes, frames.time, margin, _colour(index), name)
    axes.axhspan(0.0, influence, color="0.5", alpha=0.09, linewidth=0.0)
    axes.axhline(0.0, color=_WRONG, linewidth=1.1)
    told = []
    for what, sign, marker, tightest in (
        ("least", "o", "o", plan.certificate.obstacle_clearance),
        ("to itself", "\N{WHITE SQUARE}", "s", plan.certificate.self_clearance),
    ):
        if tightest is not None:
            lowest, highest = min(lowest, tightest.margin), max(highest, 1.12 * tightest.margin)
            axes.plot(
                tightest.time, tightest.margin, marker, markersize=6, markerfacecolor="none", color="#1d2731", zorder=5,
            )  # fmt: skip
            told.append(f"{what} ({sign}): {margin_text(tightest.margin, '.3f')} m at {tightest.time:.2f} s")
    axes.text(0.0, 1.02, ", ".join(told), transform=axes.transAxes, fontsize=8.5, ha="left", va="bottom")
    top = min(highest, 2.0 * influence)
    axes.set_ylim(lowest - 0.04 * (top - lowest), top)
    axes.set_ylabel("margin [m]")
    if far:
        axes.plot([], [], linestyle="", label=f"({far} further off)")
    _legend(axes)
    _say(axes, "beyond the clearance; shaded: obstacles act")


def _kept(axes: Axes, plan: Plan, problem: Problem, frames: Timeline, *, unit: str) -> None:
    """The remaining margins of the conditions of this unit."""
    scale, shown = (np.degrees(1.0), "deg") if unit == "rad" else (1.0, "m")
    colours: dict[str, str] = {}  # of each condition; the same one in several legs is named once
    for begins, ends, conditions in kept_parts(plan):
        within = (frames.time >= begins) & (frames.time <= ends)
        for condition in conditions:
            if condition.unit == unit and within.any():
                left = scale * condition.margins(condition.values(frames.q[within]))
                name = f"{condition.name},\n{condition.allowed}"
                label = "" if name in colours else name
                colour = colours.setdefault(name, _colour(len(colours)))
                _curve(axes, frames.time[within], left, colour, label)
    axes.axhline(0.0, color=_WRONG, linewidth=1.1)
    axes.set_ylabel(f"left to keep [{shown}]")
    _legend(axes)
    _say(axes, "how far within what is to be kept")


def _deviation(axes: Axes, plan: Plan, problem: Problem, frames: Timeline) -> None:
    assert problem.path is not None
    assert plan.scene.task.path is not None
    off = 1e3 * np.array([problem.path.nearest(tip)[1] for tip in frames.tip])
    tolerance = 1e3 * plan.scene.task.path.tolerance
    for number, detour in enumerate(plan.certificate.detours):
        axes.axvspan(
            detour.time_from, detour.time_to, color="#f2b705", alpha=0.18, linewidth=0.0,
            label="detour" if number == 0 else None,
        )  # fmt: skip
    approach = plan.certificate.tracking.approach_time
    if approach > 0.0:
        axes.axvspan(frames.time[0], approach, color="0.5", alpha=0.12, linewidth=0.0, label="on its way there")
    _curve(axes, frames.time, off, "#1f6fd6", "tip")
    axes.axhline(tolerance, color=_WRONG, linewidth=1.0, linestyle=_DASHES, label="tolerance")
    far = off.max() > 20.0 * tolerance
    if far:
        axes.set_yscale("symlog", linthresh=2.0 * tolerance)
    axes.set_ylim(0.0, max(1.15 * off.max(), 1.4 * tolerance))
    axes.set_ylabel("off the path [mm]")
    _legend(axes)


def _limits(axes: Axes, plan: Plan, problem: Problem, frames: Timeline) -> None:
    motion = with_rests_apart(plan.trajectory)
    usage = limit_usage(problem, motion)
    on_the_way = usage.moments.time < plan.certificate.tracking.approach_time  # no tip speed is required there
    asked = np.array([kind == "tip speed" for kind, _ in usage.limits])
    usage = replace(usage, ratio=np.where(np.outer(on_the_way, asked), 0.0, usage.ratio))
    drawn = moments_to_draw(motion, usage.moments)
    binding, time, greatest = usage.binding[drawn], usage.moments.time[drawn], usage.greatest[drawn]
    used = 100.0 * np.minimum(greatest, 1.5)
    binds = greatest >= _BINDS
    named: dict[str, float] = {}
    begins = np.flatnonzero(np.diff(np.where(binds, binding, -1), prepend=-2))
    for first, last in zip(begins, np.append(begins[1:], len(time) - 1), strict=True):
        part = slice(first, last + 1)
        name = usage.names[binding[first]] if binds[first] else ""
        named[name] = named.get(name, 0.0) + float(time[last] - time[first])
        colour, hatch = _limit_look(name, plan.robot.joint_names)
        axes.fill_between(time[part], used[part], facecolor=colour, edgecolor="white", hatch=hatch, linewidth=0.0)
    by_duration = sorted(filter(None, named), key=lambda name: -named[name])
    for name in by_duration[:_MOST_NAMED]:
        colour, hatch = _limit_look(name, plan.robot.joint_names)
        axes.fill_between([], [], facecolor=colour, edgecolor="white", hatch=hatch, linewidth=0.0, label=name)
    if len(by_duration) > _MOST_NAMED:
        axes.plot([], [], linestyle="", label=f"({len(by_duration) - _MOST_NAMED} more, shorter)")
    axes.axhline(100.0, color=_WRONG, linewidth=1.0, linestyle=_DASHES)
    axes.set_ylim(0.0, max(112.0, 1.05 * float(np.max(used))))
    axes.set_yticks([0.0, 50.0, 100.0])
    axes.set_ylabel("limit used [%]")
    if any(named):
        _legend(axes)
    _say(axes, "the limit that is used most, but for positions; coloured where it binds")


def moments_to_draw(trajectory: Trajectory, moments: Moments) -> NDArray[np.bool_]:
    """(M,) which of a trajectory's `moments` are drawn: the samples, and what lies between samples that are far apart.

    Between the samples of a smooth motion, the samples beside them say it.
    """
    sample = np.diff(moments.segment, prepend=-1) > 0
    far = np.append(np.diff(trajectory.time) > SAMPLE_PERIOD * (1.0 + 1e-6), False)
    return np.asarray(sample | far[moments.segment])


def with_rests_apart(trajectory: Trajectory) -> Trajectory:
    """The same motion with two more samples in each segment that is a rest, one period from its ends.

    What a machine uses at rest is then seen between the samples at which it stops and starts.
    """
    time, q, v = trajectory.time, trajectory.q, trajectory.v
    rests = np.flatnonzero((np.diff(time) > 3.0 * SAMPLE_PERIOD) & (np.diff(q, axis=0) == 0.0).all(axis=1))
    at = np.repeat(rests + 1, 2)
    inside = np.column_stack((time[rests] + SAMPLE_PERIOD, time[rests + 1] - SAMPLE_PERIOD)).ravel()
    return replace(
        trajectory,
        time=np.insert(time, at, inside),
        q=np.insert(q, at, q[at - 1], axis=0),
        v=np.insert(v, at, 0.0, axis=0),
        begins=tuple(first + int(np.count_nonzero(at <= first)) for first in trajectory.begins),
    )


def _limit_look(name: str, joints: tuple[str, ...]) -> tuple[str, str | None]:
    """Colour and hatch of a limit: a joint's own colour, and a hatch for the kind of limit."""
    if name in _SHARED:
        return _SHARED[name], None
    for joint, own in enumerate(joints):
        if name.endswith(f" {own}"):
            return _colour(joint), _HATCHES.get(name.removesuffix(f" {own}"))
    return "0.85", None


def torques_to_draw(problem: Problem, trajectory: Trajectory) -> tuple[Vector, NDArray[np.float64]]:
    """(K,) moments [s] and (K, n) torques of the joints at them [N m], by legs and rests.

    Where two legs meet, or a rest begins or ends, there are moments with the torques on either side.
    """
    times, torques = [], []
    for part in leg_parts(problem, trajectory):
        motion = with_rests_apart(part.motion)
        times.append(part.begins + motion.time)
        torques.append(trajectory_energy(part.problem, motion).torque)
    return np.concatenate(times), np.concatenate(torques)


def _torques(axes: Axes, plan: Plan, problem: Problem, frames: Timeline) -> None:
    time, torque = torques_to_draw(problem, plan.trajectory)
    largest = float(np.max(np.abs(torque), initial=0.0))
    prefix, scale = _prefix(largest)
    for joint in range(plan.robot.n):
        axes.plot(time, scale * torque[:, joint], color=_colour(joint), linewidth=1.6)
    axes.axhline(0.0, color="0.6", linewidth=0.8)
    forces = np.any(plan.robot.prismatic)
    axes.set_ylabel(f"torque [{prefix}N m]" if not forces else f"torque or force [{prefix}N m, {prefix}N]")
    _say(axes, f"of the joints, against {_loads(plan)}")


def _power(axes: Axes, plan: Plan, problem: Problem, frames: Timeline) -> None:
    """Power and energy of the joints or of the oil; for a task along a path, also the local law's energy."""
    time = plan.trajectory.time
    power, spent = _spent(problem, plan.trajectory)
    prefix, scale = _prefix(float(power.max()))
    axes.fill_between(time, scale * power, color="#5b7fa6", alpha=0.25, linewidth=0.0)
    _curve(axes, time, scale * power, "#3d6692", "power")
    axes.set_ylim(0.0, max(1.12 * scale * power.max(), 1e-9))
    axes.set_ylabel(f"power [{prefix}W]")
    right = axes.twinx()
    right.spines[["top", "left"]].set_visible(False)
    right.tick_params(labelsize=8.5, color="0.6")
    what = "energy" if problem.objective.needs_hydraulics else "work"
    curves: list[tuple[Vector, Vector, str, Any, str]] = [(time, spent, "#d55e00", (0, (6, 2)), what)]
    title = f"what {'the oil puts' if what == 'energy' else 'the joints put'} in, against {_loads(plan)}"
    compared = None
    if plan.metrics.objective is not None:
        compared = compare_with_law(problem, plan.trajectory, plan.certificate)
    if compared is not None and compared.law_motion is not None:
        offset = float(np.interp(compared.begun, time, spent))
        law = offset + _spent(problem, compared.law_motion)[1]
        name = "local law" if compared.figures.law_breaks is None else "local law,\nbreaks a limit"
        curves.append((compared.begun + compared.law_motion.time, law, "0.35", (0, (1.5, 1.5)), name))
        figures = compared.figures
        if figures.saving_percent is not None:
            beside = describe_saving(figures.saving_percent, law="the local law's")
            title += f"; {figures.name} along the path {beside}"
    highest = max(float(values[-1]) for _, values, *_ in curves)
    prefix, scale = _prefix(highest)
    lines = [
        right.plot(at, scale * values, color=colour, linewidth=1.6, linestyle=dashes, label=name)[0]
        for at, values, colour, dashes, name in curves
    ]
    right.set_ylim(0.0, max(1.12 * scale * highest, 1e-9))
    right.set_ylabel(f"{what} [{prefix}J]", fontsize=9)
    _legend(axes, more=lines, aside=1.085)
    _say(axes, title)


def _spent(problem: Problem, motion: Trajectory) -> tuple[Vector, Vector]:
    """(T,) power [W] and energy [J]: of the joints, or of the oil if the objective is about the oil."""
    energy = trajectory_energy(problem, motion)
    if problem.objective.needs_hydraulics and energy.hydraulic is not None:
        assert energy.hydraulic_power is not None
        return energy.hydraulic_power, energy.hydraulic
    return energy.power, energy.work


def _prefix(largest: float) -> tuple[str, float]:
    """The prefix of a unit, and the scale to it, for numbers up to `largest`."""
    return ("k", 1e-3) if largest >= 1000.0 else ("", 1.0)


def _loads(plan: Plan) -> str:
    loads = ["gravity", "inertia"]
    if plan.legs:
        return "gravity, inertia and the loads of each leg"
    if plan.scene.payload > 0.0:
        loads.append(f"{plan.scene.payload:g} kg of payload")
    if plan.scene.soil is not None:
        loads.append("soil")
    return f"{', '.join(loads[:-1])} and {loads[-1]}"


def _curve(axes: Axes, time: Vector, values: Vector, colour: str, label: str) -> None:
    alone = "o" if len(time) == 1 else None
    axes.plot(time, values, color=colour, linewidth=1.6, marker=alone, label=plain_text(label))


def _legend(axes: Axes, *, more: Sequence[Line2D] = (), aside: float = 1.01) -> None:
    handles, labels = axes.get_legend_handles_labels()
    handles, labels = [*handles, *more], [*labels, *(str(line.get_label()) for line in more)]
    axes.legend(
        handles, labels,
        loc="upper left", bbox_to_anchor=(aside, 1.03), fontsize=8.5, frameon=False, handlelength=1.4,
        borderaxespad=0.0, labelspacing=0.35,
    )  # fmt: skip


def _say(axes: Axes, text: str) -> None:
    say_above(axes, text, loc="right", fontsize=8, color="0.45", pad=3)


def _colour(index: int) -> str:
    return PLOT_CYCLE[index % len(PLOT_CYCLE)]
