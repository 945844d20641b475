#!/usr/bin/env python
"""A haptic loop at 1 kHz: a simulated hand pushes the bucket against a wall and feels the force.

The hand is a mass with a spring and a damper towards the position that its person wants. It
moves a joystick whose velocity is the wish for the tip, and the servo's force acts on it. The
person moves the hand to and fro on a closed cycle. The plot shows over time the tip's position,
the margin to the wall, the force, and the energy that the force gave to the hand, which is never
above 0 for a passive device. docs/live.md defines the force.

    python scripts/haptic_loop.py [--seconds 12] [--save out/force.png]
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np

import backhoe_planner as bp

DT = 0.001
MASS, SPRING, DAMPER = 0.5, 120.0, 8.0  # kg, N/m, N s/m of the hand
REACH = 0.3  # m, the amplitude of the hand
PERIOD = 4.0  # s
WALL = 4.4  # m
SCALE = 2.0  # ratio of the tip's velocity to the hand's

Record = dict[str, np.ndarray]


def simulate(seconds: float, *, period: float = PERIOD, reach: float = REACH) -> Record:
    """The loop: hand -> wish -> servo -> force -> hand."""
    robot = bp.load_robot("example:backhoe")
    scene = bp.scene_from_dict(
        {
            "version": 1,
            "start": {"joints": {"swing": 0.0, "boom": 0.4, "stick": -1.4, "bucket": -0.6}},
            "task": {"goal": {"position": [4.0, 0.0, 0.0]}},
            "obstacles": [{"name": "wall", "shape": "halfspace", "point": [WALL, 0, 0], "normal": [-1, 0, 0]}],
        }
    )
    servo = bp.Servo(robot, scene, dt=DT)
    x, x_dot, force = np.zeros(3), np.zeros(3), np.zeros(3)
    rows: dict[str, list[object]] = {name: [] for name in ("time", "tip", "margin", "force", "hand", "work")}
    work = 0.0
    for step in range(round(seconds / DT)):
        phase = 2.0 * np.pi * step * DT / period
        wanted = reach * np.array([1.0 - np.cos(phase), 0.5 * np.sin(phase), 0.0])
        # the force of the last sample holds over this one
        x_dot = x_dot + DT / MASS * (SPRING * (wanted - x) - DAMPER * x_dot + force)
        x = x + DT * x_dot
        work += DT * float(force @ x_dot)
        state = servo.step(SCALE * x_dot)
        # the same scale for velocity and force preserves power
        force = SCALE * state.feedback_force
        for name, value in zip(rows, (step * DT, state.tip_position, state.margin, force, x, work), strict=True):
            rows[name].append(value)
    return {name: np.array(values) for name, values in rows.items()}


def draw(record: Record, path: Path) -> None:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8, 9), layout="constrained")
    axes = figure.subplots(4, 1, sharex=True)
    time = record["time"]
    axes[0].plot(time, record["tip"][:, 0], label="tip")
    axes[0].axhline(WALL, color="0.4", linestyle="--", label="wall")
    axes[0].set_ylabel("x [m]")
    axes[0].legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
    # the bucket's corners are nearer than the tip, the middle of its edge
    axes[1].plot(time, np.where(np.isfinite(record["margin"]), record["margin"], np.nan))
    axes[1].set_ylim(bottom=0.0)
    axes[1].set_ylabel("margin of the nearest\npart of the machine [m]")
    for axis, name in enumerate("xyz"):
        axes[2].plot(time, record["force"][:, axis], label=name)
    axes[2].set_ylabel("force on the hand [N]")
    axes[2].legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
    axes[3].plot(time, record["work"])
    axes[3].set_ylabel("work on the hand [J]")
    axes[3].set_xlabel("time [s]")
    figure.savefig(path, dpi=120)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=12.0)
    parser.add_argument("--save", type=Path, default=Path("out/force.png"))
    arguments = parser.parse_args()
    record = simulate(arguments.seconds)
    arguments.save.parent.mkdir(parents=True, exist_ok=True)
    draw(record, arguments.save)
    force = np.linalg.norm(record["force"], axis=1)
    figures = {
        "greatest force [N]": float(force.max()),
        "greatest change of force in 1 ms [N]": float(np.abs(np.diff(record["force"], axis=0)).max()),
        "least margin [m]": float(record["margin"].min()),
        "greatest work done on the hand [J]": float(record["work"].max()),
        "work done on the hand at the end [J]": float(record["work"][-1]),
    }
    print(json.dumps(figures, indent=2))


if __name__ == "__main__":
    main()
