"""Output paths: links, and names that no file can have."""

from __future__ import annotations

from pathlib import Path

import pytest

from backhoe_planner.errors import InputError, OutputError
from backhoe_planner.files.found_file import is_file, is_folder
from backhoe_planner.files.output_file import check_apart, check_writable, whole_file
from backhoe_planner.files.text_file import read_text


def test_circular_links_are_refused(tmp_path: Path) -> None:
    one, other = tmp_path / "one.json", tmp_path / "other.json"
    one.symlink_to(other)
    other.symlink_to(one)
    for check in (check_writable, lambda path: whole_file(path).__enter__()):
        with pytest.raises(OutputError, match=r"one\.json: cannot be written"):
            check(one)


def test_a_link_counts_as_its_target(tmp_path: Path) -> None:
    link, file = tmp_path / "link.json", tmp_path / "file.json"
    link.symlink_to(file)
    assert check_writable(link) == file.resolve()
    with whole_file(link) as stream:
        stream.write("1")
    assert link.is_symlink()
    assert file.read_text(encoding="utf-8") == "1"
    with pytest.raises(OutputError, match=r"link\.json: is also the path of another output"):
        check_apart([file, None, link])
    check_apart([file, tmp_path / "other.json", None, None])


@pytest.mark.parametrize("name", ["a" * 300, "a\0b"])
def test_a_name_that_no_file_can_have_is_neither_readable_nor_writable(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    assert not is_file(path)
    assert not is_folder(path)
    with pytest.raises(OutputError, match="cannot be written"):
        check_writable(path)
    with pytest.raises(InputError, match=r"no such scene file|cannot be read"):
        read_text(path, what="scene")
