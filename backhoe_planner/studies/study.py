"""`study`: many plans of one scene or job in one call, as a data frame."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from backhoe_planner.errors import InputError, StudyError, check_kind, check_path
from backhoe_planner.job import Job
from backhoe_planner.machine import Robot
from backhoe_planner.site import Scene, load_scene
from backhoe_planner.studies.schema.study_file import Study, load_study, study_from_dict
from backhoe_planner.studies.schema.values import plain
from backhoe_planner.studies.study_run import StudyResult, StudyStep, run_study


def study(
    study: Study | Robot | Job | str | os.PathLike[str],
    scene: Scene | str | os.PathLike[str] | None = None,
    *,
    parameters: Mapping[str, Any] | None = None,
    combine: str = "grid",
    count: int | None = None,
    seed: int = 0,
    metrics: Sequence[str] | None = None,
    folder: str | os.PathLike[str] | None = None,
    scheduler: str | None = None,
    jobs: int = -1,
    watch: Callable[[StudyStep], object] | None = None,
) -> Any:
    """Plan one scene or job many times, with parameters that differ from row to row.

    Parameters
    ----------
    study: a study or its file; with a scene, the machine: loaded, a URDF file or ``example:NAME``; or a job.
    scene: the template, or its file.
    parameters: with a machine or a job, the values that differ: by key path (``obstacles.pipe.position``) a list,
        ``{"from": a, "to": b, "count": n}``, ``{"uniform": [a, b]}`` and so on, as in a study file.
    combine, count, seed, metrics: with `parameters`, as in a study file.
    folder: for the results, so that an interrupted study can be resumed; by default nothing is kept.
    scheduler: address of a Dask cluster that plans the rows; by default processes of this computer do.
    jobs: how many processes; -1 for one on each core.
    watch: called with a `StudyStep` at the beginning, after every row, and while many rows are drawn.

    Returns
    -------
    A `pandas.DataFrame` with a row for every plan: `row`, the parameters, `verdict`, `reason`, `message`, the
    metrics, `versions`. Its ``attrs["units"]`` has the units of the columns of parameters and metrics that have one.

    Raises
    ------
    StudyError: the study cannot be run as it is written, the folder is of another one, the cluster cannot be reached.
    InputError: an argument is not allowed, or a package is missing.
    KeyboardInterrupt: it was interrupted; with a `folder`, the rows that are done are kept there.

    Examples
    --------
    >>> frame = bp.study("example:planar4", "scenes/paper_planar.yaml", parameters={"clearance": [0.1, 0.2]})
    """
    asked = _asked(study, scene, parameters, combine=combine, count=count, seed=seed, metrics=metrics)
    if folder is not None:
        return _frame(run_study(asked, check_path(folder, key="folder"), scheduler=scheduler, jobs=jobs, watch=watch))
    with tempfile.TemporaryDirectory(prefix="backhoe_planner-study-") as scratch:
        return _frame(run_study(asked, Path(scratch), scheduler=scheduler, jobs=jobs, watch=watch))


def _frame(result: StudyResult) -> Any:
    table = result.table
    if result.interrupted:
        raise KeyboardInterrupt
    frame = table.to_pandas()
    frame.attrs["units"] = result.template.column_units
    return frame


def _asked(study: Any, scene: Any, parameters: Any, **others: Any) -> Study:
    """The study that the arguments describe."""
    if scene is None and not isinstance(study, (Robot, Job)):
        if parameters is not None:
            raise InputError(
                "cannot be given for a study, which has its own",
                key="parameters",
                allowed="parameters with a machine and a scene",
            )
        return study if isinstance(study, Study) else load_study(check_path(study, key="study"))
    content: dict[str, Any] = {"version": 1, "parameters": dict(_mapping(parameters))}
    for key, value in others.items():
        if value is not None:
            try:
                content[key] = plain(value)
            except ValueError as error:
                raise InputError(str(error), key=key) from None
    if isinstance(study, Job):
        if scene is not None:
            raise InputError("cannot be given beside a job", key="scene", allowed="a job, or a machine and a scene")
        return _made(content | {"job": study.to_dict()}, study.folder, site=study.site_scene.folder)
    template = scene if isinstance(scene, Scene) else None
    if scene is None:
        raise InputError("is missing: what the machine is to do", key="scene", allowed="a scene or its file")
    if template is None:
        template = load_scene(check_path(scene, key="scene"))
    machine = study.urdf.source if isinstance(study, Robot) else str(check_path(study, key="study"))
    if not machine.startswith("example:") and Path(machine).exists():
        machine = str(Path(machine).absolute())
    return _made(content | {"machine": machine, "scene": template.to_dict()}, template.folder)


def _made(content: dict[str, Any], folder: Path, *, site: Path | None = None) -> Study:
    if site is not None and site.resolve() != folder.resolve():
        raise InputError(
            "has its site in another folder", key="study", found=str(site), allowed="a study file that names the job"
        )
    try:
        return study_from_dict(content, folder=folder)
    except StudyError as error:
        raise InputError(error.problem) from None


def _mapping(parameters: Any) -> Mapping[str, Any]:
    if parameters is None:
        return {}
    return check_kind(parameters, Mapping, key="parameters")  # type: ignore[type-abstract]
