"""The colours on the page, in the viewer and in the plots, and what they mean."""

from __future__ import annotations

Rgba = tuple[float, float, float, float]
Rgb = tuple[float, float, float]


def _rgb(code: str) -> Rgb:
    return (int(code[0:2], 16) / 255.0, int(code[2:4], 16) / 255.0, int(code[4:6], 16) / 255.0)


PATH = _rgb("1f6fd6")
TRACE = _rgb("f07f13")
GOAL = _rgb("1fa35c")
PASSED_BY = _rgb("9aa5ad")  # goals when another one is reached
KEPT = _rgb("7a4fbf")  # the axis that a tilt keeps, and where it may point
UNTOUCHED = (0.78, 0.76, 0.70)  # level ground, and soil that was not dug
SOIL = _rgb("917659")
LOOSE_SOIL = _rgb("b39770")  # soil that was dug, in a heap or a bucket
LOAD = _rgb("b9b3aa")  # what the machine carries
MACHINE = _rgb("e9ad25")  # if the URDF gives no colour

FAR = _rgb("2fa866")
NEAR = _rgb("f2b705")
TIGHT = _rgb("d93025")

# distinguishable in print and for colour-blind readers (Okabe and Ito, darkened where pale)
PLOT_CYCLE = ("#0072b2", "#d55e00", "#009e73", "#b5428b", "#b58900", "#3fa0d0", "#5b5b5b", "#7a4fbf", "#8c5a2b")


def margin_rgb(margin: float, influence: float) -> Rgb:
    """Colour of a margin [m]: green from half the influence distance on, red at 0."""
    part = min(max(2.0 * margin / influence, 0.0), 1.0)
    low, high, mix = (TIGHT, NEAR, 2.0 * part) if part < 0.5 else (NEAR, FAR, 2.0 * part - 1.0)
    r, g, b = (a + mix * (c - a) for a, c in zip(low, high, strict=True))
    return (r, g, b)
