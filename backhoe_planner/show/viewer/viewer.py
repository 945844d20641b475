"""The live view: a page in the browser that shows planning as it goes on, and plays plans."""

from __future__ import annotations

import threading
import time as clock
from types import TracebackType

import numpy as np
from numpy.typing import NDArray

from backhoe_planner.errors import InputError
from backhoe_planner.live import shown_problem
from backhoe_planner.motion import Problem
from backhoe_planner.planning import Plan
from backhoe_planner.show.drawing.scene_graph import GROUPS, SceneGraph
from backhoe_planner.show.drawing.timeline import nearest_spots, obstacle_names, sight, timeline
from backhoe_planner.show.page.page_content import plan_content, problem_content, step_content
from backhoe_planner.show.viewer.live_server import LiveServer
from backhoe_planner.site import Proximity

__all__ = ["Viewer"]

Vector = NDArray[np.float64]

_FRAME = 1.0 / 30.0  # s between drawn steps
_GRACE = 4.0  # s within which a page may be loaded again
_SHARE = 0.04  # of the caller's time that drawing may take


class Viewer:
    """Shows problems, steps and plans in every browser that opens `url`.

    It is a consumer: nothing is handed back, and a browser that is slow, or none at
    all, does not hold the caller up. It belongs to the thread that made it; call its
    methods from there. Close it, or use it in a ``with`` block.

    Parameters
    ----------
    host: the address on which it listens; by default this machine alone can connect.
    port: None takes the first free one from 7000 on, 0 any.

    Raises
    ------
    OutputError: the port is taken.

    Examples
    --------
    >>> with Viewer(port=0) as viewer:
    ...     viewer.url.startswith("http://127.0.0.1:")
    True
    """

    def __init__(self, *, host: str = "127.0.0.1", port: int | None = None) -> None:
        self._thread = threading.get_ident()
        self._server = LiveServer(host=host, port=port)
        self._visualizer = self._server.recording.visualizer()
        self._problem: Problem | None = None
        self._graph: SceneGraph | None = None
        self._proximity: Proximity | None = None
        self._obstacles: tuple[str, ...] = ()
        self._next_frame = 0.0

    @property
    def url(self) -> str:
        """Where the page is."""
        return self._server.url

    @property
    def watched(self) -> bool:
        """Whether a page is open that shows the present picture."""
        return self._server.somebody_watches.is_set()

    def wait_for_browser(self, timeout: float | None = None) -> bool:
        """Wait until a page is open that has drawn what was shown so far.

        Parameters
        ----------
        timeout: after which to give up [s]; None waits until interrupted.

        Returns
        -------
        Whether there is one.
        """
        return self._server.somebody_watches.wait(timeout)

    def alive(self) -> bool:
        """Whether anybody may still be watching: False once closed, or once every page is.

        A page may be loaded again within a few seconds.
        """
        left = self._server.left_at
        return self._server.running and (left is None or clock.monotonic() - left < _GRACE)

    def show_problem(self, problem: Problem) -> tuple[str, ...]:
        """Show machine, site and task.

        Returns
        -------
        What could not be drawn as the URDF asks, in words.
        """
        self._check_thread()
        recording = self._server.recording
        for kind in ("problem", "plan", "step"):
            recording.forget(kind)
        graph = self._draw(problem, None)
        recording.tell(problem_content(problem, graph, graph.view(), self._obstacles))
        return graph.warnings

    def show_step(self, q: Vector, time: float = 0.0) -> bool:
        """Show the machine at `q` (n,) and `time` [s], unless a step was drawn just before.

        Up to 30 steps a second are drawn, fewer where drawing would take more than 4 %
        of the time; the others return at once. Call it as often as you like.

        Returns
        -------
        Whether it was drawn.

        Raises
        ------
        InputError: no problem is shown, or `q` does not fit the machine.
        """
        begun = clock.perf_counter()
        if begun < self._next_frame:
            return False
        self._check_thread()
        if self._problem is None or self._graph is None or self._proximity is None:
            raise InputError("show a problem first", key="show_step")
        posture = self._problem.robot.check_q(q)
        spots = nearest_spots(self._proximity, self._obstacles, posture, time=time, within=sight(self._problem))
        self._graph.move(posture, time=time, nearest=spots)
        self._server.recording.tell(step_content(time, posture, spots, self._problem.robot.link_names))
        ended = clock.perf_counter()
        self._next_frame = ended + max(_FRAME, (ended - begun) / _SHARE)
        return True

    def play(self, plan: Plan) -> tuple[str, ...]:
        """Show a plan, with its verdict and a scrubber, and play it.

        Returns
        -------
        What could not be drawn as the URDF asks, in words.
        """
        self._check_thread()
        recording = self._server.recording
        problem = shown_problem(plan)
        for kind in ("problem", "plan", "step"):
            recording.forget(kind)
        graph = self._draw(problem, plan.trajectory.q[0])
        frames = timeline(problem, plan.trajectory)
        graph.draw_trace(frames.tip)
        view = graph.look_at_motion(frames)
        self._visualizer.set_animation(graph.animation(frames), play=False)
        recording.tell(problem_content(problem, graph, view, frames.obstacles))
        recording.tell(plan_content(plan, frames, view))
        return graph.warnings

    def close(self) -> None:
        """End the connection to every page; the pages keep their picture."""
        self._server.close()

    def __enter__(self) -> Viewer:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _draw(self, problem: Problem, q: Vector | None) -> SceneGraph:
        for group in GROUPS:
            self._visualizer[group].delete()
        self._problem = problem
        self._graph = SceneGraph(self._visualizer, problem, q=q)
        self._proximity = Proximity(problem.robot, problem.obstacles)
        self._obstacles = obstacle_names(problem, self._proximity)
        self._next_frame = 0.0
        return self._graph

    def _check_thread(self) -> None:
        if threading.get_ident() != self._thread:
            raise InputError("belongs to the thread that made it", key="Viewer", hint="make one in this thread")
