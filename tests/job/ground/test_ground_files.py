"""Ground from files: georeferenced heights, holes that are named or filled, and scans during a job."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from PIL.TiffImagePlugin import ImageFileDirectory_v2
from small_jobs import small_job

from backhoe_planner.arrays import Array, Matrix
from backhoe_planner.errors import InputError
from backhoe_planner.job import (
    BladeSweep,
    Terrain,
    build_worksite,
    deposited,
    job_from_dict,
    read_ground,
    scanned,
    swept,
)
from backhoe_planner.job.ground.grids import HeightGrid, resampled
from backhoe_planner.site import build_obstacle, obstacle_from_dict, read_heights

NAN = float("nan")


def plane(points: Array) -> Array:
    return np.asarray(0.1 * points[..., 0] - 0.2 * points[..., 1] + 0.3)


def nodes(low: tuple[float, float], counts: tuple[int, int], cell: float) -> Array:
    x, y = np.meshgrid(low[0] + cell * np.arange(counts[1]), low[1] + cell * np.arange(counts[0]))
    return np.stack((x, y), axis=-1)


def write_geotiff(
    path: Path, heights: Matrix, *, corner: tuple[float, float] | None, cell: float = 0.5, **more: Any
) -> Path:
    """Write heights with ascending rows as a file whose first row is the northmost; `corner` is the north-west one."""
    tags = ImageFileDirectory_v2()
    keys = {1024: 1, 1025: 1} | more.pop("keys", {})
    if corner is not None:
        tags[33550], tags.tagtype[33550] = (cell, more.pop("cell_y", cell), 0.0), 12
        tags[33922], tags.tagtype[33922] = (0.0, 0.0, 0.0, *corner, 0.0), 12
        tags[34735], tags.tagtype[34735] = (
            tuple(v for key in ((1, 1, 0, len(keys)), *((k, 0, 1, keys[k]) for k in sorted(keys))) for v in key),
            3,
        )
    for tag, (kind, value) in more.pop("tags", {}).items():
        tags[tag], tags.tagtype[tag] = value, kind
    if "words" in more:
        tags[34737], tags.tagtype[34737] = more.pop("words"), 2
    if "metadata" in more:
        tags[42112], tags.tagtype[42112] = more.pop("metadata"), 2
    if "no_data" in more:
        tags[42113], tags.tagtype[42113] = more.pop("no_data"), 2
    Image.fromarray(heights[::-1].astype(np.float32)).save(path, tiffinfo=tags, **more)
    return path


MAP = (500_000.0, 4_100_000.0, 120.0)


def test_ground_in_map_coordinates_is_moved_by_its_map_origin(tmp_path: Path) -> None:
    """Heights of a plane over 0 to 3 m along x and 0 to 2 m along y of the site, 120 m above the sea."""
    places = nodes((0.0, 0.0), (5, 7), 0.5)
    heights = plane(places)
    corner = (MAP[0] - 0.25, MAP[1] + 2.25)
    points = np.column_stack((places.reshape(-1, 2), heights.ravel())) + MAP
    np.savetxt(tmp_path / "ground.xyz", points, fmt="%.6f")
    files = (write_geotiff(tmp_path / "ground.tif", heights + MAP[2], corner=corner), tmp_path / "ground.xyz")
    for file in files:
        found = Terrain.from_file(file, cell=0.5, map_origin=MAP)
        np.testing.assert_allclose(found.low, [0.0, 0.0], atol=1e-6)
        np.testing.assert_allclose(found.surface, heights, atol=1e-5)
        part = Terrain.from_file(file, cell=0.5, low=(1.0, 0.5), map_origin=MAP)
        np.testing.assert_allclose(part.low, [1.0, 0.5], atol=1e-6)
        np.testing.assert_allclose(part.surface, heights[1:, 2:], atol=1e-5)
    with pytest.raises(InputError, match=r"`map_origin: \[50000[12], 4100001, 120\]` puts the middle of the survey"):
        Terrain.from_file(tmp_path / "ground.xyz", cell=0.5)
    np.savetxt(tmp_path / "ground.csv", heights, delimiter=",")
    with pytest.raises(InputError, match="map_origin: does not place its heights on a map"):
        Terrain.from_file(tmp_path / "ground.csv", low=(0.0, 0.0), cell=0.5, map_origin=MAP)


def test_a_cloud_that_lies_elsewhere_is_refused_with_its_place(tmp_path: Path) -> None:
    """Points over 3 m x 2 m, in millimetres."""
    points = np.column_stack((nodes((0.0, 0.0), (5, 7), 0.5).reshape(-1, 2), np.zeros(35)))
    np.savetxt(tmp_path / "ground.xyz", 1000.0 * points, fmt="%.1f")
    with pytest.raises(InputError, match=r"no point on .*from x 0, y 0 to x 3000, y 2000 m; .*coordinates are metres"):
        Terrain.from_file(tmp_path / "ground.xyz", low=(1.0, 0.5), high=(2.0, 1.5), cell=0.5)
    with pytest.raises(InputError, match=r"too many columns; .*coordinates are metres"):
        Terrain.from_file(tmp_path / "ground.xyz")


def test_a_geotiff_that_lies_elsewhere_is_refused_with_its_place(tmp_path: Path) -> None:
    """Heights from 120 to 122 m over 3 m x 2 m in map coordinates, on a site whose ground is asked for from 1 m on."""
    heights = 120.0 + nodes((0.0, 0.0), (5, 7), 0.5)[..., 1]
    file = write_geotiff(tmp_path / "ground.tif", heights, corner=(MAP[0] - 0.25, MAP[1] + 2.25))
    said = (
        r"no height on the ground .*from x 500000, y 4100000 to x 500003, y 4100002 m.*\[1\.0, 0\.5\].*"
        r"`map_origin: \[50000[12], 4100001, 120\]`"
    )
    with pytest.raises(InputError, match=said):
        Terrain.from_file(file, low=(1.0, 0.5), high=(2.0, 1.5), cell=0.5)
    with pytest.raises(
        InputError, match=said.replace("500000, y 4100000 to x 500003, y 4100002", "70, y 0 to x 73, y 2")
    ):
        Terrain.from_file(file, low=(1.0, 0.5), high=(2.0, 1.5), cell=0.5, map_origin=(MAP[0] - 70.0, *MAP[1:]))


def test_a_geotiff_places_its_heights(tmp_path: Path) -> None:
    # pixels are areas: the north-west corner is half a cell off the first height
    low, counts = (500_001.0, 4_100_003.0), (5, 7)
    heights = plane(nodes((0.0, 0.0), counts, 0.5))
    corner = (low[0] - 0.25, low[1] + 2.0 + 0.25)
    for compression in (None, "tiff_lzw", "tiff_adobe_deflate"):
        file = write_geotiff(tmp_path / "site.tif", heights, corner=corner, compression=compression)
        found = Terrain.from_file(file)
        np.testing.assert_allclose(found.low, low, atol=1e-9)
        assert found.cell == 0.5
        np.testing.assert_allclose(found.surface, heights, atol=1e-6)
    # pixels are points
    file = write_geotiff(tmp_path / "site.tiff", heights, corner=(1.0, 5.0), keys={1025: 2})
    np.testing.assert_allclose(Terrain.from_file(file).low, [1.0, 3.0], atol=1e-9)
    # moved to the machine, and on a finer grid: heights between those of a plane lie on the plane
    moved = Terrain.from_file(file, low=(-1.0, -2.0))
    np.testing.assert_allclose(moved.low, [-1.0, -2.0])
    part = Terrain.from_file(file, low=(1.3, 3.2), high=(3.3, 4.4), cell=0.1)
    assert part.shape == (13, 21)
    np.testing.assert_allclose(part.surface, plane(nodes((0.3, 0.2), (13, 21), 0.1)), atol=1e-6)


def test_scale_and_offset_of_a_geotiff_give_its_heights(tmp_path: Path) -> None:
    """As written by GDAL: whole centimetres above a level; the no-data value is compared before scaling."""
    scaled = '<Item name="{}" sample="{}" role="{}">{}</Item>'
    items = (("SCALE", 0, "scale", 0.01), ("OFFSET", 0, "offset", -2.7), ("SCALE", 1, "scale", 7.0))
    metadata = f"<GDALMetadata>{''.join(scaled.format(*item) for item in items)}</GDALMetadata>"
    numbers = np.array([[300.0, 270.0], [-9999.0, 0.0]])
    file = write_geotiff(tmp_path / "a.tif", numbers, corner=None, metadata=metadata)
    np.testing.assert_allclose(read_heights(file), [[0.3, 0.0], [-102.69, -2.7]], atol=1e-12)
    file = write_geotiff(tmp_path / "a.tif", numbers, corner=None, metadata=metadata, no_data="-9999")
    with pytest.raises(InputError, match="row 2, column 1: a height is missing"):
        read_heights(file)
    plain = "<GDALMetadata><Item name='AREA'>here</Item></GDALMetadata>"
    file = write_geotiff(tmp_path / "b.tif", np.abs(numbers), corner=None, metadata=plain)
    np.testing.assert_array_equal(read_heights(file), np.abs(numbers))


def test_an_obstacle_may_be_a_geotiff(tmp_path: Path) -> None:
    heights = np.arange(12.0).reshape(3, 4)
    write_geotiff(tmp_path / "hill.tif", heights, corner=None)
    np.testing.assert_allclose(read_heights(tmp_path / "hill.tif"), heights)
    record = {"name": "hill", "shape": "heightmap", "file": "hill.tif", "size": [3.0, 2.0]}
    found = build_obstacle(obstacle_from_dict(record), folder=tmp_path, clearance=0.1)
    assert max(piece.hull[:, 2].max() for piece in found.pieces) == pytest.approx(11.0)
    write_geotiff(tmp_path / "hill.tif", np.where(heights == 6.0, -9999.0, heights), corner=None, no_data="-9999")
    with pytest.raises(InputError, match=r"hill\.tif: row 2, column 3: a height is missing"):
        build_obstacle(obstacle_from_dict(record), folder=tmp_path, clearance=0.1)


@pytest.mark.parametrize(
    ("keys", "parts"),
    [
        ({"keys": {1024: 2}}, ["is in degrees", "UTM"]),
        ({"keys": {3076: 9002}}, ["is not in metres", "9002"]),
        ({"keys": {3076: 9001, 4099: 9003}}, ["heights are not in metres", "9003"]),
        ({"words": "NAD83 / California zone 5 (ftUS)|NAD83|"}, ["is not in metres", "zone 5 (ftUS)"]),
        ({"metadata": "<GDALMetadata><Item"}, ["scale and offset of its heights cannot be read"]),
        (
            {"metadata": "<GDALMetadata><Item sample='0' role='offset'>nan</Item></GDALMetadata>"},
            ["scale and offset of its heights cannot be read: found 1 and nan"],
        ),
        ({"tags": {274: (3, 4)}}, ["Orientation: has its rows in another order; found 4", "from north to south"]),
        ({"tags": {33550: (12, 0.5)}}, ["ModelPixelScale", "found 0.5", "3 numbers"]),
        ({"tags": {33922: (12, (0.0, 0.0, 0.0))}}, ["ModelTiepoint", "6 numbers"]),
        ({"tags": {34264: (12, (1.0, 0.0, 0.0))}}, ["ModelTransformation", "16 numbers"]),
        ({"tags": {33550: (12, (0.5, 0.5, 2.0))}}, ["a scale or an offset of heights; found 2 and 0 m"]),
        ({"tags": {33922: (12, (0.0, 0.0, 0.0, 1.0, 1.0, 100.0))}}, ["found 0 and 100 m"]),
        ({"tags": {33550: (12, (0.5, -0.5, 0.0))}}, ["is flipped; found rows from south to north"]),
        (
            {"tags": {34264: (12, (-0.5, *4 * [0.0], 0.5, *9 * [0.0], 1.0))}},
            ["columns from east to west and rows from"],
        ),
        ({"cell_y": 0.7}, ["are not square", "0.5 x 0.7 m"]),
    ],
)
def test_unusable_geotiffs_are_refused_naming_the_file(tmp_path: Path, keys: dict[str, Any], parts: list[str]) -> None:
    file = write_geotiff(tmp_path / "a.tif", np.zeros((3, 3)), corner=(0.0, 0.0), **keys)
    with pytest.raises(InputError) as caught:
        Terrain.from_file(file)
    assert all(part in str(caught.value) for part in [*parts, str(file)])


@pytest.mark.parametrize(
    ("kind", "white", "stored", "heights"),
    [
        (1, 1, [[0, 3], [200, 255]], [[0.0, 3.0], [200.0, 255.0]]),
        (1, 0, [[255, 252], [55, 0]], [[0.0, 3.0], [200.0, 255.0]]),  # Pillow writes as it reads: inverted
        (2, 1, [[0, 3], [254, 255]], [[0.0, 3.0], [-2.0, -1.0]]),
    ],
)
def test_heights_of_8_bits_are_the_numbers_in_the_file(
    tmp_path: Path, kind: int, white: int, stored: list[list[int]], heights: list[list[float]]
) -> None:
    """Signed or not, and whichever of the numbers is shown bright."""
    tags = ImageFileDirectory_v2()
    for tag, value in ((339, kind), (262, white)):
        tags[tag], tags.tagtype[tag] = value, 3
    file = tmp_path / "a.tif"
    Image.fromarray(np.array(stored, dtype=np.uint8)[::-1]).save(file, tiffinfo=tags)
    with Image.open(file) as written:
        found = dict(getattr(written, "tag_v2", {}))
        assert found[262] == white
        offset, length = found[273][0], found[279][0]
    raw = np.frombuffer(file.read_bytes()[offset : offset + length], dtype=np.uint8).reshape(2, 2)[::-1]
    np.testing.assert_array_equal(raw.view(np.int8) if kind == 2 else raw, heights)
    np.testing.assert_array_equal(read_heights(file), heights)


def test_feet_in_the_name_of_a_projection_do_not_count_if_its_unit_is_given(tmp_path: Path) -> None:
    words = "an area of 2 feet|"
    file = write_geotiff(tmp_path / "a.tif", np.zeros((3, 3)), corner=(0.0, 1.0), keys={3076: 9001}, words=words)
    assert Terrain.from_file(file).cell == 0.5


def test_the_size_of_a_height_map_must_be_that_of_its_geotiff(tmp_path: Path) -> None:
    """3 x 4 heights 0.5 m apart are 1.5 m along x and 1 m along y, or one cell more if cells are counted."""
    write_geotiff(tmp_path / "hill.tif", np.ones((3, 4)), corner=(500_000.0, 4_100_000.0))
    for size in ([1.5, 1.0], [2.0, 1.5]):
        record = {"name": "hill", "shape": "heightmap", "file": "hill.tif", "size": size}
        build_obstacle(obstacle_from_dict(record), folder=tmp_path, clearance=0.1)
    swapped = obstacle_from_dict({"name": "hill", "shape": "heightmap", "file": "hill.tif", "size": [1.0, 2.5]})
    with pytest.raises(InputError, match=r"hill\.tif: size: .* found \[1, 2\.5\].* \[1\.5, 1\], along x and y"):
        build_obstacle(swapped, folder=tmp_path, clearance=0.1)


def test_files_that_are_not_geotiffs_are_refused(tmp_path: Path) -> None:
    file = tmp_path / "a.tif"
    with pytest.raises(InputError, match="no such height map file"):
        Terrain.from_file(file)
    file.write_bytes(b"1,2\n3,4\n")
    with pytest.raises(InputError, match="is not a TIFF that can be read"):
        Terrain.from_file(file)
    write_geotiff(file, np.zeros((40, 40)), corner=(0.0, 0.0))
    file.write_bytes(file.read_bytes()[:2000])
    with pytest.raises(InputError, match=r"a\.tif"):
        Terrain.from_file(file)
    Image.new("RGB", (4, 4)).save(file)
    with pytest.raises(InputError, match="is not a height map; found 3 bands"):
        Terrain.from_file(file)


def test_holes_in_the_ground_are_named_or_filled(tmp_path: Path) -> None:
    file = tmp_path / "ground.csv"
    heights = plane(nodes((2.0, 1.0), (21, 31), 0.1))
    holes = heights.copy()
    holes[8:12, 10:13] = NAN
    lines = [",".join("" if np.isnan(z) else f"{z:.12g}" for z in row) for row in holes]
    file.write_text("\n".join(lines), encoding="utf-8")
    with pytest.raises(InputError) as caught:
        Terrain.from_file(file, low=(2.0, 1.0), cell=0.1)
    for part in (
        str(file),
        "row 9, column 11 (x 3.00 m, y 1.80 m)",
        "12 of 651 columns",
        "fill: holes are up to 0.2 m from",
    ):
        assert part in str(caught.value)
    with pytest.raises(InputError, match="a height is missing"):  # the middle of the hole is two columns from its rim
        Terrain.from_file(file, low=(2.0, 1.0), cell=0.1, fill=0.15)
    found = Terrain.from_file(file, low=(2.0, 1.0), cell=0.1, fill=0.2)
    np.testing.assert_allclose(found.surface, heights, atol=1e-9)
    for keys, missing in (({"cell": 0.1}, "low"), ({"low": (0.0, 0.0)}, "cell")):
        with pytest.raises(InputError, match=f"{missing}: does not say where its heights lie"):
            Terrain.from_file(file, **keys)
    file.write_text("1,2,\n3,nan,\n", encoding="utf-8")
    with pytest.raises(InputError, match="row 2, column 2"):
        Terrain.from_file(file, low=(0.0, 0.0), cell=1.0)
    file.write_text("1,2\n3,deep\n", encoding="utf-8")
    with pytest.raises(InputError, match="row 2, column 2: is not a number; found deep"):
        Terrain.from_file(file, low=(0.0, 0.0), cell=1.0, fill=5.0)


def test_a_coarser_grid_has_the_mean_of_the_heights_within_its_columns() -> None:
    """Of each 3 x 3 heights one beside the middle is 0.9 m and the others are 0: 0.1 m on average, 0 in the middle."""
    z = np.zeros((9, 6))
    z[2::3, 0::3] = 0.9
    found = resampled(HeightGrid(np.array([1.0, 2.0]), 0.1, z), HeightGrid(np.array([1.1, 2.1]), 0.3, np.zeros((3, 2))))
    np.testing.assert_allclose(found.z, np.full((3, 2), 0.1), atol=1e-12)


def test_the_columns_within_a_rectangle_are_those_with_their_node_in_it() -> None:
    ground = Terrain.level(0.0, (0.0, -3.0), (6.0, 3.0), 0.05)
    low, high = np.array([0.12, -2.93]), np.array([0.31, -2.79])
    # x from 0.15 to 0.30 m, y from -2.90 to -2.80 m
    assert ground.columns_within(low, high) == (slice(2, 5), slice(3, 7))
    assert ground.columns_within(low, high, margin=0.05) == (slice(1, 6), slice(2, 8))
    rows, columns = ground.columns_within(np.array([-9.0, -9.0]), np.array([-8.0, 9.0]))
    assert (rows, columns.stop - columns.start) == (slice(0, 121), 0)


def test_columns_get_the_mean_height_of_their_points(tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    points = rng.uniform([0.0, 0.0, 0.0], [3.0, 2.0, 0.0], (30_000, 3))
    points[:, 2] = plane(points[:, :2])
    np.savetxt(tmp_path / "scan.xyz", points, fmt="%.9f")
    found = Terrain.from_file(tmp_path / "scan.xyz", low=(0.1, 0.1), high=(2.9, 1.9), cell=0.1)
    assert found.shape == (19, 29)
    np.testing.assert_allclose(found.surface, plane(nodes((0.1, 0.1), (19, 29), 0.1)), atol=0.01)
    apart = points[np.hypot(*(points[:, :2] - [1.0, 1.0]).T) > 0.2]
    with pytest.raises(InputError, match=r"\(x 0\.90 m, y 0\.90 m\)"):
        Terrain.from_points(apart, (0.1, 0.1), (2.9, 1.9), 0.1)
    filled = Terrain.from_points(apart, (0.1, 0.1), (2.9, 1.9), 0.1, fill=0.3)
    np.testing.assert_allclose(filled.surface, found.surface, atol=0.02)


def test_a_scan_shows_the_dug_and_heaped_volumes(tmp_path: Path) -> None:
    before = Terrain.level(0.0, (0.0, -2.0), (6.0, 2.0))
    dug = swept(before, BladeSweep([[4.0, 0.0, -0.5], [2.0, 0.0, -0.5]], (0.0, 1.0, 0.0), 0.6)).terrain  # type: ignore[arg-type]
    after = deposited(dug, (3.0, 1.3), 0.1)
    assert isinstance(after, Terrain)
    file = tmp_path / "scan.csv"
    rng = np.random.default_rng(6)
    z = after.surface + rng.uniform(-0.01, 0.01, after.shape)
    z[:10] = NAN  # rows that the scanner did not see
    np.savetxt(file, z, delimiter=",")
    found = scanned(before, file, low=(0.0, -2.0), cell=0.05)
    assert (found.unknown == np.isnan(z)).all()
    assert found.terrain.bank_volume_below(before) == pytest.approx(2.0 * 0.6 * 0.5, rel=0.01)
    assert found.terrain.loose_volume == pytest.approx(0.1, rel=0.05)
    # the same ground on another grid: the walls of a trench then extend over a cell
    coarse = nodes((0.5, -1.0), (14, 34), 0.15)
    np.savetxt(file, after.height_at(coarse), delimiter=",")
    found = scanned(dug, file, low=(0.5, -1.0), cell=0.15, noise=0.1)
    assert found.unknown[0, 0]
    assert not found.unknown[40, 60]
    assert found.terrain.bank_volume_below(dug) == pytest.approx(0.0, abs=0.06)
    with pytest.raises(InputError, match="lies nowhere on the ground"):
        scanned(before, file, low=(50.0, 0.0), cell=0.15)


def test_a_point_cloud_taken_during_a_job_becomes_its_ground(tmp_path: Path) -> None:
    job = small_job()
    own = build_worksite(job).ground
    dug = swept(own, BladeSweep([[4.4, 0.0, -0.1], [3.2, 0.0, -0.1]], (0.0, 1.0, 0.0), 0.6)).terrain  # type: ignore[arg-type]
    after = deposited(dug, (2.5, -3.0), 0.1)
    assert isinstance(after, Terrain)
    seen = np.column_stack([*(axis.ravel() for axis in np.meshgrid(after.x, after.y)), after.surface.ravel()])
    seen = seen[seen[:, 0] > 1.5]  # the ground beside the machine is unknown
    np.savetxt(tmp_path / "scan.xyz", seen, fmt="%.6f")
    found = read_ground(job, tmp_path / "scan.xyz")
    assert found.terrain.bank_volume_below(own) == pytest.approx(1.2 * 0.6 * 0.1, rel=0.01)
    assert found.terrain.loose_volume == pytest.approx(0.1, rel=0.05)  # without its foot, which is lower than 2 cm
    assert (found.unknown == np.broadcast_to(own.x < 1.5 + 1e-9, own.shape)).all()
    assert (found.terrain.surface[found.unknown] == 0.0).all()
    np.savetxt(tmp_path / "scan.xyz", seen[np.hypot(seen[:, 0] - 3.8, seen[:, 1]) > 0.12], fmt="%.6f")
    with pytest.raises(InputError, match=r"does not cover what is dug.*ground\.fill"):
        read_ground(job, tmp_path / "scan.xyz")


def test_a_geotiff_taken_during_a_job_in_map_coordinates_is_where_it_says(tmp_path: Path) -> None:
    """The ground of the job, and that with a trench of 1.2 x 0.6 m, 0.1 m deep, in a larger file, cells of 0.1 m."""
    places = nodes((-1.0, -6.0), (90, 80), 0.1)
    heights, corner = np.zeros(places.shape[:2]), (MAP[0] - 1.05, MAP[1] + 2.95)
    write_geotiff(tmp_path / "before.tif", heights + MAP[2], corner=corner, cell=0.1)
    job = small_job()
    ground = {"file": "before.tif", "map_origin": list(MAP), "low": [0.5, -4.5], "high": [6.0, 1.5], "cell": 0.1}
    job = job_from_dict(job.to_dict() | {"ground": ground}, folder=tmp_path)
    found = read_ground(job, tmp_path / "before.tif")
    np.testing.assert_allclose(found.terrain.surface, 0.0, atol=1e-4)
    assert found.remark == ""
    x, y = places[..., 0], places[..., 1]
    dug = np.where((np.abs(x - 3.8) < 0.61) & (np.abs(y) < 0.31), -0.1, 0.0)
    after = write_geotiff(tmp_path / "after.tif", dug + MAP[2], corner=corner, cell=0.1)
    found = read_ground(job, after)
    own = build_worksite(job).ground
    assert not found.unknown.any()
    assert found.terrain.bank_volume_below(own) == pytest.approx(-dug.sum() * 0.01, rel=1e-3)
    column = np.unravel_index(int(np.argmin(found.terrain.surface)), own.shape)
    assert abs(own.x[column[1]] - 3.8) < 0.61
    assert abs(own.y[column[0]]) < 0.31
    # heights without a place are still those of the job's own columns
    np.savetxt(tmp_path / "after.csv", found.terrain.surface, delimiter=",")
    np.testing.assert_allclose(
        read_ground(job, tmp_path / "after.csv").terrain.surface, found.terrain.surface, atol=1e-9
    )
