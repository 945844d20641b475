from .drawing.animation import PlanAnimation, Track
from .drawing.framing import FIELD_OF_VIEW, frame
from .drawing.machine_meshes import machine_meshes
from .drawing.names import node_name, node_names
from .drawing.palette import FAR, TIGHT, margin_rgb
from .drawing.scene_graph import SceneGraph
from .drawing.site_meshes import site_mesh
from .drawing.solids import facets, fattened, grid, solid, together, tube
from .drawing.timeline import ITSELF, timeline
from .page.display import Display
from .page.page import plan_page, write_page
from .plots.plots import plot_envelope, plot_plan
from .teleop.joysticks import joint_rates
from .teleop.messages import LARGEST, Add, Sticks, parse
from .teleop.server import TeleopServer
from .teleop.session import Session
from .teleop.station import TeleopStation, free_name
from .teleop.wording import Telling, Wording
from .viewer.live_server import LiveServer, LiveSocket
from .viewer.viewer import Viewer

__all__ = [
    "FAR",
    "FIELD_OF_VIEW",
    "ITSELF",
    "LARGEST",
    "TIGHT",
    "Add",
    "Display",
    "LiveServer",
    "LiveSocket",
    "PlanAnimation",
    "SceneGraph",
    "Session",
    "Sticks",
    "TeleopServer",
    "TeleopStation",
    "Telling",
    "Track",
    "Viewer",
    "Wording",
    "facets",
    "fattened",
    "frame",
    "free_name",
    "grid",
    "joint_rates",
    "machine_meshes",
    "margin_rgb",
    "node_name",
    "node_names",
    "parse",
    "plan_page",
    "plot_envelope",
    "plot_plan",
    "site_mesh",
    "solid",
    "timeline",
    "together",
    "tube",
    "write_page",
]
