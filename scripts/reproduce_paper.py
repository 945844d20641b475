#!/usr/bin/env python
"""Draw the paper's Figures 5 and 6, and count over random scenes how general their outcomes are.

    python scripts/reproduce_paper.py [--out out/paper] [--scenes 300] [--seed 0]

The folder gets figure_5 and figure_6 (PNG and SVG), the same for a second scene,
population.png/.svg, and the tables as CSV and Markdown.

The paper prints neither link lengths nor positions. `SHOWN` is our own scene with four
links of 1 m, found by search, in which the law as printed behaves as in the paper:
without the obstacle term the arm passes through the obstacle; with it the tip does not
arrive in a hundred iterations; with directionality it arrives after about 25 and the arm
stays outside the region. Such scenes are rare, and the middle case is chaotic: the
critical point jumps from link to link at the edge of the region.

`NAMED` is a second scene, in which the tip arrives with the obstacle term alone, unless
(J_o N)^+ is taken of rounding noise: with the tip itself as the critical point, J_o N is 0,
and the inverse of its rounding errors is 1e15.

The random scenes and their figures are those of validation/printed_laws.py.
The results are in docs/theory.md and docs/measurements.md.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Circle

import backhoe_planner as bp
from backhoe_planner.arrays import Matrix
from validation.printed_laws import (
    ARRIVED,
    PUSH_SPEED,
    REGION,
    Outcome,
    PointScene,
    PrintedLaw,
    count_point_scenes,
    count_solid_scenes,
    iterate,
    measure,
    printed_laws,
)
from validation.tables import Row, markdown, write_csv

SHOWN = PointScene(
    start=np.array([1.42, 1.86, 1.71, 1.16]), goal=np.array([0.45, -2.16, 0.0]), obstacle=np.array([0.63, 0.59, 0.0])
)
NAMED = PointScene(
    start=np.array([-2.0, -0.85, -1.83, -1.57]), goal=np.array([2.2, -2.33, 0.0]), obstacle=np.array([1.78, -1.34, 0.0])
)
SOLID_SCENES = 100

ARM = mpl.colormaps["viridis"]
INK, FAINT, RED, GREEN = "#222222", "#9aa0a6", "#c0392b", "#1e8449"
JOINTS = ("#2f6db0", "#c26a1c", "#3a8f5c", "#8a4fa3")
NOTE = (
    "Four links of 1 m; the paper prints neither lengths nor positions, the scene is ours. "
    rf"$s_e = 0.2$, $s_o = {{s_o:g}}$, $s_1 = s_2 = {{s_k:g}}$, $|\dot x_o| = {PUSH_SPEED:g}$ m."
)


@dataclass(frozen=True)
class Case:
    """One law on one scene."""

    law: PrintedLaw
    motion: Matrix
    outcome: Outcome


def cases(kinematics: bp.Kinematics, scene: PointScene) -> list[Case]:
    """The paper's three cases: no terms, obstacle term only, with directionality."""
    found = []
    for law in printed_laws(kinematics.robot.joint_names)[:3]:
        motion = iterate(kinematics, scene, law)
        found.append(Case(law, motion, measure(kinematics, scene, motion)))
    return found


# --- figures ----------------------------------------------------------------------------


def draw_case(kinematics: bp.Kinematics, scene: PointScene, case: Case, plain: Case, title: str) -> Figure:
    """Arm poses, tip path, joint angles: the paper's (a), (b), (c)."""
    figure = Figure(figsize=(14.0, 5.9))
    grid = figure.add_gridspec(1, 3, left=0.05, right=0.985, top=0.81, bottom=0.235, wspace=0.2)
    poses, path, angles = (figure.add_subplot(grid[0, column]) for column in range(3))
    figure.text(0.05, 0.94, title, fontsize=14, color=INK, weight="bold")
    figure.text(0.05, 0.885, describe(case.outcome), fontsize=11, color=INK)
    s_k = max(case.law.gains.s_k.values(), default=0.0)
    figure.text(0.05, 0.03, NOTE.format(s_o=case.law.gains.s_o, s_k=s_k), fontsize=9.5, color="#555555")
    _poses(poses, kinematics, scene, case.motion)
    _tip_path(path, kinematics, scene, case.motion, plain.motion)
    _angles(angles, case)
    for axes in (poses, path):
        _metres(axes, kinematics, scene, case.motion)
    for axes in (poses, path, angles):
        axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.13), ncols=4, fontsize=9.5, frameon=False)
    return figure


def describe(outcome: Outcome) -> str:
    """The outcome in one sentence."""
    there = (
        f"On the goal (within {100 * ARRIVED:g} cm) from iteration {outcome.arrival}"
        if outcome.arrives
        else f"Not on the goal after 100 iterations ({outcome.error:.2f} m off)"
    )
    return (
        f"{there}; nearest pose {outcome.at_samples:.2f} m from the obstacle; "
        f"largest joint step {outcome.largest_step:.2f} rad in one iteration."
    )


def _poses(axes: Axes, kinematics: bp.Kinematics, scene: PointScene, motion: Matrix) -> None:
    shown = [*range(0, min(30, len(motion))), *range(30, len(motion), 5)]
    for index in shown:
        points = kinematics.at(motion[index]).points
        axes.plot(*points[:, :2].T, color=ARM(min(index / 30.0, 1.0) * 0.9), lw=1.0, alpha=0.5, zorder=2)
    for index, label in ((0, "start"), (-1, "end")):
        points = kinematics.at(motion[index]).points
        axes.plot(*points[:, :2].T, "-o", color=ARM(-0.9 * index), lw=2.6, ms=4.5, zorder=4, label=label)
    _site(axes, scene)
    axes.plot(0.0, 0.0, "s", color=INK, ms=8, zorder=5, label="base")
    axes.set_title("(a) arm poses, dark to light over 30 iterations", fontsize=11, loc="left")


def _tip_path(axes: Axes, kinematics: bp.Kinematics, scene: PointScene, motion: Matrix, plain: Matrix) -> None:
    tips, straight = (np.array([kinematics.at(q).tip_position[:2] for q in run]) for run in (motion, plain))
    _site(axes, scene)
    axes.plot(*straight.T, "--", color=FAINT, lw=1.3, label="without obstacle term", zorder=2)
    axes.plot(*tips.T, "-", color=JOINTS[0], lw=1.0, alpha=0.6, zorder=3)
    axes.plot(*tips.T, "o", color=JOINTS[0], ms=3.2, label="tip, one dot an iteration", zorder=3)
    axes.plot(*tips[0], "o", color=INK, ms=7, label="start", zorder=4)
    axes.set_title("(b) path of the tip", fontsize=11, loc="left")


def _site(axes: Axes, scene: PointScene) -> None:
    middle = (float(scene.obstacle[0]), float(scene.obstacle[1]))
    axes.add_patch(Circle(middle, REGION, fc=RED, ec=RED, alpha=0.13, lw=0, zorder=1))
    axes.add_patch(Circle(middle, REGION, fc="none", ec=RED, lw=1.2, ls=(0, (4, 3)), zorder=5))
    axes.plot(*middle, "o", color=RED, ms=4.5, zorder=6)
    axes.annotate(
        f"region {REGION:g} m", (middle[0], middle[1] + REGION), xytext=(0, 4), textcoords="offset points",
        ha="center", color=RED, fontsize=9.5, zorder=6,
    )  # fmt: skip
    axes.plot(*scene.goal[:2], "*", color=GREEN, ms=15, mec="white", zorder=7)
    goal = (float(scene.goal[0]), float(scene.goal[1]))
    axes.annotate("goal", goal, xytext=(0, -19), textcoords="offset points", ha="center", color=GREEN, fontsize=10)


def _metres(axes: Axes, kinematics: bp.Kinematics, scene: PointScene, motion: Matrix) -> None:
    """A square around all poses, the region and the goal."""
    points = np.vstack([kinematics.at(q).points[:, :2] for q in motion])
    around = np.vstack((points, scene.goal[:2], scene.obstacle[:2] - REGION, scene.obstacle[:2] + REGION))
    middle = 0.5 * (around.min(axis=0) + around.max(axis=0))
    half = 0.65 * float(np.max(np.ptp(around, axis=0)))
    axes.set(xlim=(middle[0] - half, middle[0] + half), ylim=(middle[1] - half, middle[1] + half), aspect="equal")
    axes.set(xlabel="x [m]", ylabel="y [m]")
    axes.grid(color="#e6e6e6", lw=0.6)
    axes.set_axisbelow(True)


def _angles(axes: Axes, case: Case) -> None:
    names = (rf"$\theta_{joint}$" for joint in range(1, 5))
    for column, colour, name in zip(np.degrees(case.motion).T, JOINTS, names, strict=True):
        axes.plot(column, color=colour, lw=1.6, label=name)
    arrival = case.outcome.arrival
    if arrival is not None and case.outcome.arrives:
        axes.axvline(arrival, color=GREEN, lw=1.2, ls=(0, (4, 3)))
        axes.annotate(
            f"on the goal: {arrival}", (arrival, 1.0), xycoords=("data", "axes fraction"), xytext=(5, -13),
            textcoords="offset points", color=GREEN, fontsize=9.5,
        )  # fmt: skip
    axes.set(xlabel="iteration", ylabel="joint angle [deg]", xlim=(0, len(case.motion) - 1))
    axes.margins(y=0.12)
    axes.grid(color="#e6e6e6", lw=0.6)
    axes.set_title("(c) joint angles", fontsize=11, loc="left")


def draw_population(rows: Sequence[Row], count: int) -> Figure:
    """Bars of the shares of scenes in which each law reaches the goal, touches and jumps."""
    shown = (
        ("reaches without touching [%]", "reaches the goal without touching", GREEN),
        ("touches [%]", "touches the obstacle on its way", RED),
        ("joint step over 1 rad [%]", "some joint turns over 1 rad in one step", "#d9a441"),
    )
    figure = Figure(figsize=(11.0, 6.8))
    axes = figure.add_axes((0.33, 0.13, 0.63, 0.74))
    place = np.arange(len(rows), dtype=float)[::-1]
    for offset, (key, label, colour) in zip((0.26, 0.0, -0.26), shown, strict=True):
        shares = [float(row[key]) for row in rows]
        bars = axes.barh(place + offset, shares, height=0.23, color=colour, label=label)
        axes.bar_label(bars, fmt="%.0f", padding=3, fontsize=9, color=INK)
    axes.set_yticks(place, [str(row["law"]) for row in rows], fontsize=10)
    axes.set(xlim=(0, 108), xlabel=f"share of {count} random scenes [%]")
    axes.set_xticks(range(0, 101, 20))
    axes.set_ylim(-0.6, len(rows) - 0.4)
    axes.spines[["top", "right", "left"]].set_visible(False)
    axes.tick_params(left=False)
    axes.grid(axis="x", color="#e6e6e6", lw=0.6)
    axes.set_axisbelow(True)
    figure.text(0.02, 0.945, "One point obstacle in the way of a planar arm", fontsize=14, weight="bold", color=INK)
    figure.text(
        0.02, 0.03, "Four links of 1 m; scenes by the recipe in validation/printed_laws.py, not the paper's.",
        fontsize=9.5, color="#555555",
    )  # fmt: skip
    figure.legend(loc="upper left", bbox_to_anchor=(0.015, 0.93), ncols=3, frameon=False, fontsize=10)
    return figure


def save(figure: Figure, folder: Path, name: str) -> None:
    FigureCanvasAgg(figure)
    for ending in ("png", "svg"):
        figure.savefig(folder / f"{name}.{ending}", dpi=130, metadata={"Date": None} if ending == "svg" else None)


# --- tables -----------------------------------------------------------------------------


def case_rows(name: str, found: Sequence[Case]) -> list[Row]:
    return [
        {
            "scene": name,
            "law": case.law.name,
            "on the goal at iteration": str(case.outcome.arrival) if case.outcome.arrives else "never",
            "error at the end [m]": round(case.outcome.error, 4),
            "nearest pose [m]": round(case.outcome.at_samples, 3),
            "nearest between poses too [m]": round(case.outcome.closest, 3),
            "largest joint step [rad]": round(case.outcome.largest_step, 3),
        }
        for case in found
    ]


def write_table(rows: Sequence[Row], folder: Path, name: str, title: str) -> None:
    text = f"{title}\n\n{markdown(rows)}\n"
    print(f"\n{text}", end="")
    (folder / f"{name}.md").write_text(text)
    write_csv(rows, folder / f"{name}.csv")


def main() -> None:
    parser = argparse.ArgumentParser(description="The paper's figures, and the laws over random scenes.")
    parser.add_argument("--out", type=Path, default=Path("out/paper"), help="folder to write to")
    parser.add_argument("--scenes", type=int, default=300, help="random scenes with one point obstacle")
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    if given.scenes < 1 or given.seed < 0:
        parser.error("--scenes must be at least 1, --seed at least 0")
    given.out.mkdir(parents=True, exist_ok=True)
    mpl.rcParams["svg.hashsalt"] = "backhoe_planner"

    kinematics = bp.Kinematics(bp.load_robot("example:planar4"))
    rows = []
    for scene, name, prefix, title in (
        (SHOWN, "shown", "", "Figure {}, reproduced: {}"),
        (NAMED, "second scene", "second_scene_", "The law of Figure {} on a second scene: {}"),
    ):
        plain, pushed, turned = cases(kinematics, scene)
        rows += case_rows(name, (plain, pushed, turned))
        for case, number, what in ((pushed, 5, "obstacle term alone"), (turned, 6, "with joint directionality")):
            figure = draw_case(kinematics, scene, case, plain, title.format(number, what))
            save(figure, given.out, f"{prefix}figure_{number}")
    write_table(rows, given.out, "scenes", "The paper's law as printed on two scenes of ours")

    rows = count_point_scenes(given.scenes, given.seed)
    write_table(rows, given.out, "population", f"One point obstacle: {given.scenes} random scenes, seed {given.seed}")
    save(draw_population(rows, given.scenes), given.out, "population")

    count = min(SOLID_SCENES, given.scenes)
    rows = count_solid_scenes(count, given.seed)
    write_table(rows, given.out, "terms", f"Terms of the completed law: {count} scenes of solid obstacles")
    print(f"\nFigures and tables are in {given.out}")


if __name__ == "__main__":
    main()
