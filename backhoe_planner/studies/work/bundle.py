"""A study as its workers get it: the template, and the bytes of every file, so that nothing is read twice.

A file that changes while the study runs has no effect, and a worker on another computer needs no files.
"""

from __future__ import annotations

import hashlib
import pickle
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from backhoe_planner.errors import OutputError, StudyError
from backhoe_planner.files.provenance import installed_versions
from backhoe_planner.machine import Robot
from backhoe_planner.studies.rows.template import Inputs, Template

_TEMPLATE = "template.pickle"


@dataclass(frozen=True, eq=False)
class Bundle:
    """All that a worker needs.

    Attributes
    ----------
    template: the part that all rows share.
    files: content of every file, by its absolute path without the first character.
    versions: of the planning packages; those of the worker must be the same.
    digest: of the template and the files.
    """

    template: Template
    files: Mapping[str, bytes]
    versions: Mapping[str, str]
    digest: str

    def unpack(self, root: Path) -> None:
        """Write the template and all files into a folder, each at its absolute path relative to that folder.

        Raises
        ------
        OutputError: it cannot be written.
        """
        try:
            root.mkdir(parents=True, exist_ok=True)
            for name, content in self.files.items():
                file = root / name
                file.parent.mkdir(parents=True, exist_ok=True)
                file.write_bytes(content)
            for folder in (self.template.folder, self.template.site_folder, self.template.machine_folder):
                (root / folder[1:]).mkdir(parents=True, exist_ok=True)  # so that `..` in a name can be resolved
            (root / _TEMPLATE).write_bytes(pickle.dumps(self.template))
        except OSError as error:
            raise OutputError(f"cannot be written: {error.strerror}", file=root) from error


def build_bundle(template: Template, inputs: Inputs) -> Bundle:
    """Read all files into a bundle.

    Raises
    ------
    StudyError: a file cannot be read.
    """
    files = {}
    for file in inputs.files:
        try:
            files[str(file)[1:]] = file.read_bytes()
        except OSError as error:
            raise StudyError(f"cannot be read: {error.strerror}", file=file) from None
    digest = hashlib.sha256(pickle.dumps(template))
    for name, content in files.items():
        digest.update(f"\0{name}\0{len(content)}\0".encode())
        digest.update(content)
    return Bundle(template, files, installed_versions(), digest.hexdigest())


def unpacked_template(root: Path) -> Template:
    """The template in a folder into which a bundle was unpacked."""
    found = pickle.loads((root / _TEMPLATE).read_bytes())
    assert isinstance(found, Template)
    return found


def check_meshes_travel(robots: tuple[Robot, ...]) -> None:
    """Check that no machine names a mesh by its absolute path on this computer.

    Raises
    ------
    StudyError: a machine does.
    """
    for robot in robots:
        shapes = [shape for link in robot.urdf.robot.links for shape in (*link.collisions, *link.visuals)]
        for shape in shapes:
            mesh = None if shape.geometry is None else shape.geometry.mesh
            if mesh is not None and mesh.filename.removeprefix("file://").startswith("/"):
                raise StudyError(
                    "names a mesh by its place on this computer, where no other finds it", file=robot.urdf.named,
                    found=mesh.filename, allowed="a path relative to the URDF, or package://...",
                )  # fmt: skip
