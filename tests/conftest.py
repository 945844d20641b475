"""The machines that most tests use, loaded once, and a browser."""

from __future__ import annotations

import atexit
import gc
import os
import shutil
import sys
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, settings
from shipped_plans import planned

import backhoe_planner as bp
from backhoe_planner.machine import Robot, load_robot

CHROMIUM = shutil.which("chromium") or "/usr/bin/chromium"
GRAPHICS = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
            "--disable-background-networking", "--disable-gpu-compositing"]  # fmt: skip

settings.register_profile("seeded", deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("seeded")


def pytest_configure() -> None:
    """What is compiled is kept: else each process, and every command that a test starts, compiles all of it again."""
    sys.dont_write_bytecode = False
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
    gc.disable()  # what is imported and collected stays to the end


def pytest_collection_finish() -> None:
    """Objects from before the first test stay to the end: garbage collection skips them from here on.

    It begins after 10,000 new objects, not after 700: it takes 0.6 in place of 1.5 percent of the time of tests.
    """
    gc.collect()
    gc.freeze()
    gc.set_threshold(10_000, 10, 10)
    gc.enable()


def pytest_unconfigure() -> None:
    """Otherwise OMPL lists all objects that Python still holds at the end; pytest's own collections skip them."""
    atexit.register(gc.unfreeze)


@pytest.fixture(scope="session")
def planar4() -> Robot:
    return load_robot("example:planar4")


@pytest.fixture(scope="session")
def backhoe() -> Robot:
    return load_robot("example:backhoe")


@pytest.fixture(scope="session")
def ur5() -> Robot:
    return load_robot("example:ur5", tip="tool0")


@pytest.fixture(scope="session")
def panda() -> Robot:
    return load_robot("example:panda", tip="panda_hand_tcp")


@pytest.fixture(scope="session")
def around_a_ball(planar4: Robot) -> bp.Plan:
    """A plan along a path of 1.2 m at 0.4 m/s, around a ball of radius 30 cm in its middle."""
    ball = {"name": "ball", "shape": "sphere", "radius": 0.3, "position": [2.0, 0.0, 0.0]}
    task = {"path": {"waypoints": [{"position": [2.0, y, 0.0]} for y in (-0.6, 0.6)], "speed": 0.4}}
    content = {"version": 1, "task": task, "clearance": 0.02, "influence": 0.4, "obstacles": [ball]}
    return bp.plan(planar4, bp.scene_from_dict(content), effort="quick")


@pytest.fixture(scope="session")
def past_wall(backhoe: Robot) -> bp.Plan:
    return planned(backhoe, "wall")


@pytest.fixture(scope="session")
def level_plan(backhoe: Robot) -> bp.Plan:
    """A plan of least time whose straight braking lines leave the band of the pitch that is kept."""
    return planned(backhoe, "level_bucket")


@pytest.fixture(params=["planar4", "backhoe", "ur5", "panda"])
def any_robot(request: pytest.FixtureRequest) -> Robot:
    """Each of the four machines in turn."""
    robot: Robot = request.getfixturevalue(request.param)
    return robot


# ten frames a second: without a graphics card a frame costs as much as all other work of a page in that time
FEWER_FRAMES = """
    window.requestAnimationFrame = (draw) => setTimeout(() => draw(performance.now()), 100);
    window.cancelAnimationFrame = clearTimeout;
"""
# everything but the triangles, which without a graphics card cost half of the work of a page
NO_TRIANGLES = """
    for (const context of [WebGLRenderingContext, WebGL2RenderingContext])
        context.prototype.clear = context.prototype.drawElements = context.prototype.drawArrays = () => {};
"""


class Browser:
    """Opens pages that draw few frames, and the scene in them only where a test looks at it.

    The program starts with the first page. Until it is closed, no event loop can run in this thread.
    """

    def __init__(self, api: Any) -> None:
        self._api = api
        self._playwright: Any = None
        self._opened: Any = None

    def new_page(self, *, drawn: bool = False, **settings: Any) -> Any:
        if self._opened is None:
            self._playwright = self._api.sync_playwright().start()
            self._opened = self._playwright.chromium.launch(executable_path=CHROMIUM, args=GRAPHICS)
        page = self._opened.new_page(**settings)
        page.add_init_script(FEWER_FRAMES if drawn else FEWER_FRAMES + NO_TRIANGLES)
        return page

    def close(self) -> None:
        if self._opened is not None:
            self._opened.close()
            self._playwright.stop()
            self._playwright = self._opened = None

    @staticmethod
    def complaints_of(page: Any) -> list[str]:
        """The errors on a page from now on, without those of a browser that has no graphics card."""
        complaints: list[str] = []

        def take(message: Any) -> None:
            if "GPU stall due to ReadPixels" not in message.text:
                complaints.append(message.text)

        page.on("console", take)
        page.on("pageerror", lambda error: complaints.append(str(error)))
        return complaints


BROWSER = pytest.StashKey[Browser]()


def uses_browser(item: pytest.Item | None) -> bool:
    return isinstance(item, pytest.Function) and "browser" in item.fixturenames


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Tests with a browser come first, so that one process starts it, once; the others keep their order."""
    items.sort(key=lambda item: not uses_browser(item))


@pytest.hookimpl(trylast=True)
def pytest_runtest_teardown(item: pytest.Item, nextitem: pytest.Item | None) -> None:
    """Close the browser after the last test with it."""
    opened = item.config.stash.get(BROWSER, None)
    if opened is not None and not uses_browser(nextitem):
        opened.close()


@pytest.fixture(scope="session")
def browser(request: pytest.FixtureRequest) -> Browser:
    api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    if not Path(CHROMIUM).exists():
        pytest.skip("chromium is not installed")
    return request.config.stash.setdefault(BROWSER, Browser(api))
