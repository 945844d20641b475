"""A record that is a whole YAML file: the file it was read from, and the folder of the files that it names."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from pydantic import PrivateAttr, ValidationError

from backhoe_planner.errors import InputError, SceneError, check_kind, check_path
from backhoe_planner.files.records import Record, explain
from backhoe_planner.files.yaml_text import KeyPath

if TYPE_CHECKING:
    from typing_extensions import Self

_DIALECT = "https://json-schema.org/draft/2020-12/schema"


class FileRecord(Record):
    """A record that is a whole file."""

    wrong: ClassVar[type[InputError]] = SceneError
    """The class of the exception if the file is wrong."""

    _folder: Path = PrivateAttr(default=Path())
    _file: Path | None = PrivateAttr(default=None)

    @property
    def folder(self) -> Path:
        """The folder in which files that it names are looked for."""
        return self._folder

    @property
    def file(self) -> Path | None:
        """The file from which it was read, if any."""
        return self._file

    @classmethod
    def file_schema(cls, kind: str) -> dict[str, Any]:
        """The JSON Schema of such a file; `kind` is one word for its title."""
        schema = cls.model_json_schema(by_alias=True)
        return schema | {"$schema": _DIALECT, "title": f"backhoe_planner {kind}"}

    @classmethod
    def of_content(
        cls,
        content: Mapping[str, Any],
        *,
        folder: str | Path,
        file: Path | None,
        lines: Mapping[KeyPath, int] | None,
    ) -> Self:
        """The record made from plain data.

        Parameters
        ----------
        content: keys and values as in its file.
        folder: the folder in which files that it names are looked for.
        file, lines: for messages: the file it came from, and the line of every key.

        Raises
        ------
        InputError: of the class `wrong`; names the path of the key, what was found, and what is allowed.
        """
        check_kind(content, Mapping, key="content")  # type: ignore[type-abstract]
        folder = check_path(folder, key="folder")
        file = None if file is None else check_path(file, key="file")
        try:
            record = cls.model_validate(content)
        except ValidationError as error:
            raise cls.wrong(explain(error, content, root=cls, lines=lines), file=file) from None
        record._folder, record._file = folder, file
        return record
