"""The page of a job: its content, and how it plays in a real browser."""

from __future__ import annotations

import base64
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from small_jobs import small_job

from backhoe_planner.errors import OutputError
from backhoe_planner.job import JobPlan, OffGround, job_figures, plan_job
from backhoe_planner.show import write_job_page
from backhoe_planner.show.job.ground_changes import changes_of, start_of
from backhoe_planner.show.job.job_facts import job_facts
from backhoe_planner.show.job.job_frames import job_frames, job_parts
from backhoe_planner.show.job.section import section_content


@pytest.fixture(scope="module")
def plan() -> JobPlan:
    trench = {"from": [3.9, 0.0], "to": [3.2, 0.0], "width": 0.6, "depth": 0.3}
    made = plan_job(small_job(dig={"trench": trench}), effort="quick")
    assert made.verified
    return made


def unpacked(text: str, kind: str) -> np.ndarray[Any, Any]:
    return np.frombuffer(base64.b64decode(text), dtype=kind)


def test_the_parts_follow_each_other_over_the_whole_job(plan: JobPlan) -> None:
    parts = job_parts(plan)
    assert parts[0].begin == 0.0
    assert all(a.end == b.begin for a, b in pairwise(parts))
    assert parts[-1].end == pytest.approx(plan.duration, abs=1e-9)
    frames = job_frames(plan)
    assert len(frames.timeline.time) == len(frames.timeline.q) == len(frames.timeline.nearest)
    for part, leg in zip(parts, [leg for cycle in plan.cycles for leg in cycle.legs], strict=True):
        frame = int(np.argmin(np.abs(frames.timeline.time - part.begin)))
        assert np.abs(frames.timeline.q[frame] - leg.trajectory.q[0]).max() < 0.05


def test_the_changes_in_order_lead_to_the_final_ground(plan: JobPlan) -> None:
    """And to its final cover of loose soil, which is complete from 4 cm on."""
    heights = unpacked(start_of(plan.start)["heights"], "<i2").astype(float)
    cover = unpacked(start_of(plan.start)["loose"], "u1").astype(float)
    changes = changes_of(plan, job_parts(plan))
    times = [change["time"] for change in changes]
    assert times == sorted(times)
    assert times[-1] <= plan.duration + 1e-9
    for change in changes:
        columns = unpacked(change["columns"], "<u4")
        heights[columns] = unpacked(change["heights"], "<i2")
        cover[columns] = unpacked(change["loose"], "u1")
    assert np.abs(heights - 1000.0 * plan.end.surface.ravel()).max() <= 1.01  # to the millimetre
    loose = plan.end.loose.ravel()
    told = loose > 5e-4  # less than that is no change
    assert told.any()
    np.testing.assert_allclose(cover[told] / 255.0, np.minimum(loose[told] / 0.04, 1.0), atol=0.02)


@pytest.mark.long
def test_the_section_runs_along_the_trench_and_contains_the_pipe(plan: JobPlan) -> None:
    """It begins 0.6 m before the nearer end, at x = 3.2: the pipe across x = 3.6 is 1 m along it."""
    section = section_content(plan, plan.cycles[0].legs[0].problem, job_frames(plan).timeline.q)
    assert section["length"] == pytest.approx(0.7 + 2 * 0.6)
    assert section["axis"] == pytest.approx(-2.6)  # the machine swings about x = y = 0
    (pipe,) = section["crossings"]
    assert (pipe["name"], pipe["station"], pipe["z"]) == ("pipe", pytest.approx(1.0), pytest.approx(-1.0))
    assert pipe["half"] == pytest.approx(0.1)
    assert np.nanmin(section["design"]) == pytest.approx(-0.3)
    tip = section["tip"]
    assert tip["z"].min() == pytest.approx(-0.3, abs=0.02)  # the teeth go down to the design
    assert np.abs(tip["aside"][np.argmin(tip["z"])]) < 0.01


def test_the_page_shows_the_work_and_energy_of_the_plan(plan: JobPlan) -> None:
    """Work is that of the joints, energy per m^3 that of the pump, which also pays for throttling and leaks."""
    figures = job_figures(plan)
    facts = {name: (value, remark) for name, value, remark in job_facts(plan)}
    assert facts["Work"][0] == f"{figures.work / 1e3:.0f} kJ"
    assert facts["Energy"] == (
        f"{figures.kwh_per_m3:.3f} kWh/m³",
        f"of soil in the ground, from the pump; in all about {plan.fuel:.2f} l of diesel",
    )
    assert figures.kwh_per_m3 * 3.6e6 * plan.bank > plan.work


def test_a_page_needs_the_html_suffix_and_overwrites_no_input(plan: JobPlan, tmp_path: Path) -> None:
    with pytest.raises(OutputError, match=r"\.html"):
        write_job_page(plan, tmp_path / "job.pdf")
    with pytest.raises(OutputError, match="input of this command"):
        write_job_page(plan, plan.robot.urdf.path)


def test_a_job_that_fails_before_its_first_cycle_has_a_page_with_the_reason(plan: JobPlan, tmp_path: Path) -> None:
    dump = {"truck": {"bed": {"position": [1.5, -3.5, 0.4], "size": [2.5, 1.5, 0.5]}, "capacity": 1.3}}
    unplanned = replace(
        plan, job=small_job(dump=dump), cycles=(), failure="too_hard", note="stick has too little torque"
    )
    assert job_parts(unplanned) == ()
    write_job_page(unplanned, tmp_path / "job.html")
    assert "too little torque" in (tmp_path / "job.html").read_text(encoding="utf-8")


def test_without_a_cycle_the_page_shows_what_the_survey_found(plan: JobPlan, tmp_path: Path) -> None:
    """A block of 0.5 m that the job's own ground does not have, in front of the machine."""
    block = OffGround(0.1, np.array([(x, y, z) for x in range(50, 55) for y in range(-5, 0) for z in range(5)]))
    start = replace(plan.start, off_ground=block)
    write_job_page(replace(plan, cycles=(), failure="blocked", start=start), tmp_path / "job.html")
    assert "what stands at x 5.2, y -0.2 m" in (tmp_path / "job.html").read_text(encoding="utf-8")


def opened(browser: Any, file: Path) -> tuple[Any, list[str]]:
    """The page in a browser, with its complaints and network requests."""
    page = browser.new_page(viewport={"width": 900, "height": 600}, reduced_motion="reduce")
    trouble = browser.complaints_of(page)
    page.on("request", lambda request: trouble.extend([request.url] * (not request.url.startswith("file:"))))
    page.goto(file.as_uri())
    page.wait_for_function("window.backhoe !== undefined && document.querySelector('#cycles tbody') !== null")
    return page, trouble


@pytest.mark.long
def test_the_ground_is_dug_while_the_page_plays(browser: Any, plan: JobPlan, tmp_path: Path) -> None:
    write_job_page(plan, tmp_path / "job.html")
    page, trouble = opened(browser, tmp_path / "job.html")
    ground = plan.start
    column, row = np.round((np.array([3.8, 0.0]) - ground.low) / ground.cell).astype(int)
    height = (
        "backhoe.viewer.scene_tree.find(['ground', 'terrain']).object"
        f".geometry.attributes.position.getZ({row * ground.shape[1] + column})"
    )
    assert page.evaluate(height) == pytest.approx(0.0, abs=1e-3)
    through = "let n = 0; backhoe.viewer.scene_tree.find(['site', 'pipe']).object.traverse((one) => {"
    through += " if (one.isMesh && one.material.depthFunc === MeshCat.THREE.GreaterDepth) n += 1; }); return n;"
    assert page.evaluate(f"() => {{ {through} }}") == 1  # 1 m deep, it shows through the ground
    page.evaluate("backhoe.seek(1e9)")
    assert page.evaluate(height) == pytest.approx(-0.3, abs=0.02)
    assert page.inner_text("#now") == f"Cycle {len(plan.cycles)} of {len(plan.cycles)}: {plan.cycles[-1].legs[-1].name}"
    page.click("#cycles tbody tr:first-child")
    assert page.evaluate(height) == pytest.approx(0.0, abs=1e-3)
    assert page.inner_text("#now").startswith("Cycle 1 of")
    assert page.inner_text("#badge") == "Verified"
    picture, section = (page.locator(name).bounding_box() for name in ("#stage", "#section-card"))
    assert section["x"] >= picture["x"] + picture["width"]  # next to the picture, in which it would hide the bucket
    for width in (1280, 950, 760, 480):
        page.set_viewport_size({"width": width, "height": 800})
        card, button = (page.locator(name).bounding_box() for name in ("#section-card", "#section-fold"))
        assert 0.0 <= card["x"] + card["width"] - button["x"] - button["width"] < 10.0  # in the corner of the card
    assert trouble == []
    page.close()


@pytest.mark.long
def test_the_browser_shows_why_a_job_has_no_cycle(browser: Any, plan: JobPlan, tmp_path: Path) -> None:
    nothing = replace(plan, cycles=(), failure="blocked", note="no way to the first cut")
    write_job_page(nothing, tmp_path / "job.html")
    page, trouble = opened(browser, tmp_path / "job.html")
    assert page.inner_text("#message") == "no way to the first cut"
    assert not page.is_visible("#now")
    assert trouble == []
    page.close()
