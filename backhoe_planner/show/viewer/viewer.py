"""The live view: a page in the browser that shows planning in progress, and plays plans."""

from __future__ import annotations

import threading
import time as clock

from backhoe_planner.arrays import Vector
from backhoe_planner.errors import InputError
from backhoe_planner.motion import Problem
from backhoe_planner.planning import Plan
from backhoe_planner.show.drawing.scene_graph import SceneGraph
from backhoe_planner.show.drawing.timeline import FRAME, critical_points, obstacle_names, sight
from backhoe_planner.show.page.page_content import show_plan, tell_problem, tell_step
from backhoe_planner.show.viewer.live_server import LiveServer
from backhoe_planner.site import Proximity

_GRACE = 4.0  # s within which a page may be reloaded; chosen, a slow browser needs one or two
_SHARE = 0.04  # part of the caller's time that drawing may take; chosen, so that planning is hardly slower


class Viewer:
    """Shows problems, steps and plans in every browser that opens `url`.

    It only shows: nothing comes back from the browser, and a slow browser, or none at all, does not delay the caller.
    Call its methods from the thread that created it. Close it, or use it in a ``with`` block.

    Parameters
    ----------
    host, port, password, allow_anyone: see `LiveServer`.

    Raises
    ------
    InputError: other computers can connect, and neither a password nor `allow_anyone` is given.
    OutputError: the port is in use.

    Examples
    --------
    >>> with Viewer(port=0) as viewer:
    ...     viewer.url.startswith("http://127.0.0.1:")
    True
    """

    def __init__(
        self,
        *,
        host: str = "127.0.0.1",
        port: int | None = None,
        password: str | None = None,
        allow_anyone: bool = False,
    ) -> None:
        self._thread = threading.get_ident()
        self._server = LiveServer(host=host, port=port, password=password, allow_anyone=allow_anyone)
        self._graph: SceneGraph | None = None
        self._proximity: Proximity | None = None
        self._obstacles: tuple[str, ...] = ()
        self._next_frame = 0.0

    @property
    def url(self) -> str:
        """Address of the page."""
        return self._server.url

    def wait_for_browser(self, timeout: float | None = None) -> bool:
        """Wait until a page has drawn the picture, for at most `timeout` [s], and return whether one has.

        Without a timeout it waits until it is interrupted.
        """
        return self._server.somebody_watches.wait(timeout)

    def alive(self) -> bool:
        """Whether anybody may still be watching: False once it is closed, or some seconds after the last page was."""
        left = self._server.left_at
        return self._server.running and (left is None or clock.monotonic() - left < _GRACE)

    def show_problem(self, problem: Problem) -> tuple[str, ...]:
        """Show machine, site and task, and return what could not be drawn as the URDF specifies, in words."""
        self._clear()
        display = self._server.display
        graph = self._keep(SceneGraph(display.visualizer(), problem))
        tell_problem(display, problem, graph, graph.view(), self._obstacles)
        return graph.warnings

    def show_step(self, q: Vector, time: float = 0.0) -> bool:
        """Show the machine at `q` (n,) and `time` [s], unless a step was drawn just before.

        Up to 30 steps a second are drawn, fewer if drawing would take more than 4 % of the time. Calls in between
        return at once.

        Returns
        -------
        Whether the step was drawn.

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
        nearest = critical_points(self._proximity, self._obstacles, posture, time=time, within=sight(problem))
        self._graph.move(posture, time=time, nearest=nearest)
        tell_step(self._server.display, posture, time=time, nearest=nearest, links=problem.robot.link_names)
        ended = clock.perf_counter()
        self._next_frame = ended + max(FRAME, (ended - begun) / _SHARE)
        return True

    def play(self, plan: Plan) -> tuple[str, ...]:
        """Play a plan, with its verdict and a scrubber, and return what could not be drawn as the URDF specifies."""
        self._clear()
        return self._keep(show_plan(self._server.display, plan)).warnings

    def close(self) -> None:
        """Close the connection to every page; the pages keep their picture."""
        self._server.close()

    def __enter__(self) -> Viewer:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _clear(self) -> None:
        """Clear the figures of the previous display."""
        self._check_thread()
        self._server.display.forget("problem", "plan", "step")

    def _keep(self, graph: SceneGraph) -> SceneGraph:
        """Keep a graph, so that further steps move what was drawn."""
        problem, self._graph = graph.problem, graph
        self._proximity = Proximity(problem.robot, problem.obstacles)
        self._obstacles = obstacle_names(problem, self._proximity)
        self._next_frame = 0.0
        return graph

    def _check_thread(self) -> None:
        if threading.get_ident() != self._thread:
            raise InputError("belongs to the thread that made it", key="Viewer", hint="make one in this thread")
