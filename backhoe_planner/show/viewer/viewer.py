"""The live view: a page in the browser that shows planning as it goes on, and plays plans."""

from __future__ import annotations

import threading
import time as clock
from types import TracebackType

from backhoe_planner.arrays import Vector
from backhoe_planner.errors import InputError
from backhoe_planner.motion import Problem
from backhoe_planner.planning import Plan
from backhoe_planner.show.drawing.scene_graph import SceneGraph
from backhoe_planner.show.drawing.timeline import nearest_spots, obstacle_names, sight
from backhoe_planner.show.page.page_content import show_plan, tell_problem, tell_step
from backhoe_planner.show.viewer.live_server import LiveServer
from backhoe_planner.site import Proximity

_FRAME = 1.0 / 30.0  # s between drawn steps: fluent for the eye
_GRACE = 4.0  # s within which a page may be loaded again; a slow browser takes one or two
_SHARE = 0.04  # of the caller's time that drawing may take, so that planning is not noticeably slower


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
        display = self._server.display
        display.forget("problem", "plan", "step")
        graph = SceneGraph(display.visualizer(), problem)
        self._take_up(graph)
        tell_problem(display, problem, graph, graph.view(), self._obstacles)
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
        if self._graph is None or self._proximity is None:
            raise InputError("show a problem first", key="show_step")
        problem = self._graph.problem
        posture = problem.robot.check_q(q)
        spots = nearest_spots(self._proximity, self._obstacles, posture, time=time, within=sight(problem))
        self._graph.move(posture, time=time, nearest=spots)
        tell_step(self._server.display, posture, time=time, nearest=spots, links=problem.robot.link_names)
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
        display = self._server.display
        display.forget("problem", "plan", "step")
        graph = show_plan(display, plan)
        self._take_up(graph)
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

    def _take_up(self, graph: SceneGraph) -> None:
        problem = graph.problem
        self._graph = graph
        self._proximity = Proximity(problem.robot, problem.obstacles)
        self._obstacles = obstacle_names(problem, self._proximity)
        self._next_frame = 0.0

    def _check_thread(self) -> None:
        if threading.get_ident() != self._thread:
            raise InputError("belongs to the thread that made it", key="Viewer", hint="make one in this thread")
