"""Scans in PLY, PCD and LAS written by hand, byte by byte, and in LAZ and E57 written by others' libraries."""

from __future__ import annotations

import struct
from pathlib import Path

import laspy
import numpy as np
import pytest

from backhoe_planner.errors import InputError
from backhoe_planner.job import Terrain
from backhoe_planner.machine import Robot
from backhoe_planner.site import build_obstacle, obstacle_from_dict, read_points

POINTS = [[1.5, 2.5, 3.5], [4.0, 5.0, 6.0], [-7.0, 8.0, 9.25]]
LETTERS = {"float": "f", "double": "d", "uchar": "B", "int": "i", "short": "h"}


def ply(kind: str, properties: list[tuple[str, str]], rows: list[list[float]], *, before: str = "") -> bytes:
    lines = [f"property {form} {name}" for form, name in properties]
    head = "\n".join(["ply", f"format {kind} 1.0", *before.split("\n")[:-1], f"element vertex {len(rows)}", *lines])
    if kind == "ascii":
        body = "".join(" ".join(f"{number:g}" for number in row) + "\n" for row in rows).encode()
    else:
        order = "<" if "little" in kind else ">"
        body = b"".join(struct.pack(order + "".join(LETTERS[form] for form, _ in properties), *row) for row in rows)
    return f"{head}\nend_header\n".encode() + body


FLOATS, DOUBLES = ([(form, axis) for axis in "xyz"] for form in ("float", "double"))
KINDS = ("ascii", "binary_little_endian", "binary_big_endian")


@pytest.mark.parametrize("kind", KINDS)
def test_the_vertices_of_a_ply_are_points_whatever_else_it_has(kind: str, tmp_path: Path) -> None:
    file = tmp_path / "scan.ply"
    camera = "element camera 0\nproperty float view_px\n"
    coloured = [("uchar", "red"), ("double", "z"), ("float", "nx"), ("float", "y"), ("short", "x")]
    whole = [[1, 5, 3], [4, 7, 6]]
    for content, expected in (
        (ply(kind, FLOATS, POINTS), POINTS),
        (ply(kind, DOUBLES, POINTS, before=camera), POINTS),
        (ply(kind, coloured, [[7, z, 0.5, y, x] for x, y, z in whole]), whole),
        (ply(kind, FLOATS, POINTS).replace(b"\n", b"\r\n", 6 if kind != "ascii" else -1), POINTS),
        (ply(kind, FLOATS, [*POINTS, POINTS[0]]), [*POINTS, POINTS[0]]),
    ):
        file.write_bytes(content)
        np.testing.assert_array_equal(read_points(file), expected)


@pytest.mark.parametrize("order", ["<", ">"])
def test_lists_at_the_vertices_of_a_ply_may_have_different_lengths(order: str, tmp_path: Path) -> None:
    head = "element vertex 3\nproperty list uchar int seen\nproperty float x\nproperty float y\nproperty float z\n"
    kind = "little" if order == "<" else "big"
    body = b"".join(
        struct.pack(f"{order}B{seen}i3f", seen, *range(seen), *point)
        for seen, point in zip((2, 0, 3), POINTS, strict=True)
    )
    (tmp_path / "a.ply").write_bytes(f"ply\nformat binary_{kind}_endian 1.0\n{head}end_header\n".encode() + body)
    np.testing.assert_array_equal(read_points(tmp_path / "a.ply"), POINTS)
    text = "2 0 1 1.5 2.5 3.5\n0 4 5 6\n3 0 1 2 -7 8 9.25\n"
    (tmp_path / "a.ply").write_text(f"ply\nformat ascii 1.0\n{head}end_header\n{text}", encoding="utf-8")
    np.testing.assert_array_equal(read_points(tmp_path / "a.ply"), POINTS)


BINARY = ply("binary_little_endian", FLOATS, POINTS)
TEXT = ply("ascii", FLOATS, POINTS)
WRONG_PLY = {
    "no z": (ply("ascii", FLOATS[:2], [[1, 2]]), "element vertex: does not name x, y and z once each; found x, y; "),
    "capitals": (TEXT.replace(b"float x", b"float X"), "element vertex: .* found X, y, z; allowed: properties x, y"),
    "no vertices": (TEXT.replace(b"vertex", b"corner"), "header: has no points; found corner; allowed: element vertex"),
    "no end": (TEXT.replace(b"end_header", b""), "header: is not a PLY; found no line with end_header"),
    "another format": (
        TEXT.replace(b"ascii", b"binary"),
        "format: is not a PLY; found binary; allowed: ascii, binary_",
    ),
    "an unknown type": (TEXT.replace(b"float y", b"half y"), "header: is not a PLY: its header cannot be read"),
    "a short line": (TEXT.replace(b"4 5 6", b"4 5"), r"line 9: is no point; found 4 5; allowed: numbers for x, y, z"),
    "a word": (TEXT.replace(b"4 5 6", b"4 5 deep"), "line 9: is no point; found 4 5 deep"),
    "cut short": (BINARY[:-1], "is a PLY that is cut short or damaged"),
    "too long": (BINARY + b"\n", r"the file holds more than its header says; found \d+ bytes, not \d+"),
    "no points": (ply("binary_little_endian", FLOATS, []), "holds no points"),
    "not finite": (ply("ascii", FLOATS, [[1, 2, np.inf]]), "point 1, coordinate 3: a coordinate is not finite"),
    "missing": (ply("ascii", FLOATS, [[1, 2, np.nan]]), "point 1, coordinate 3: a coordinate is missing"),
}


@pytest.mark.parametrize(("content", "said"), WRONG_PLY.values(), ids=WRONG_PLY.keys())
def test_a_ply_without_points_is_refused_by_its_line_or_key(content: bytes, said: str, tmp_path: Path) -> None:
    (tmp_path / "scan.ply").write_bytes(content)
    with pytest.raises(InputError, match=rf"scan\.ply: {said}"):
        read_points(tmp_path / "scan.ply")


def pcd(data: str, body: bytes, *, rows: int = 3, **changes: str) -> bytes:
    head = {
        "VERSION": "0.7", "FIELDS": "intensity x y z _", "SIZE": "2 4 4 4 1", "TYPE": "U F F F U", "COUNT": "1 1 1 1 2",
        "WIDTH": str(rows), "HEIGHT": "1", "VIEWPOINT": "0 0 0 1 0 0 0", "POINTS": str(rows), "DATA": data,
    } | changes  # fmt: skip
    return ("# .PCD v0.7\n" + "".join(f"{key} {words}\n" for key, words in head.items() if words)).encode() + body


def rows_of(points: list[list[float]]) -> bytes:
    return b"".join(struct.pack("<H3f2B", 9, *point, 1, 2) for point in points)


def test_points_of_a_pcd_are_read_in_each_of_its_forms(tmp_path: Path) -> None:
    """Compressed by hand: a run of 6 bytes, 9 0 three times, is 9 0 and a copy of 4 bytes from 2 before."""
    text = "".join(f"9 {x} {y} {z} 1 2\n" for x, y, z in POINTS).encode()
    numbers = b"".join(struct.pack("<f", point[axis]) for axis in range(3) for point in POINTS) + b"\1\2\1\2\1\2"
    literal = [bytes([len(part) - 1]) + part for part in (numbers[:30], numbers[30:])]
    small = b"\x01\x09\x00" + bytes([(4 - 2) << 5, 1]) + b"".join(literal)
    packed = struct.pack("<II", len(small), 6 + len(numbers)) + small
    for content in (pcd("ascii", text), pcd("binary", rows_of(POINTS)), pcd("binary_compressed", packed)):
        (tmp_path / "scan.pcd").write_bytes(content)
        np.testing.assert_array_equal(read_points(tmp_path / "scan.pcd"), POINTS)


def test_points_of_a_pcd_without_an_echo_are_left_out(tmp_path: Path) -> None:
    silent = [POINTS[0], [np.nan] * 3, *POINTS[1:]]
    (tmp_path / "scan.pcd").write_bytes(pcd("binary", rows_of(silent), rows=4))
    np.testing.assert_array_equal(read_points(tmp_path / "scan.pcd"), POINTS)
    (tmp_path / "scan.pcd").write_bytes(pcd("binary", rows_of([[1.0, np.nan, 2.0]]), rows=1))
    with pytest.raises(InputError, match="point 1, coordinate 2: a coordinate is missing"):
        read_points(tmp_path / "scan.pcd")


WHOLE = rows_of(POINTS)
WRONG_PCD = {
    "no fields": (pcd("binary", WHOLE, FIELDS=""), "header: is not a PCD; found no FIELDS"),
    "another form": (pcd("zip", WHOLE), "DATA: is not a PCD; found zip; allowed: ascii, binary, binary_compressed"),
    "no z": (pcd("binary", WHOLE, FIELDS="i x y w _"), "FIELDS: does not name x, y and z once each; found i x y w _"),
    "moved": (pcd("binary", WHOLE, VIEWPOINT="1 0 0 1 0 0 0"), "VIEWPOINT: has a viewpoint, .* found 1 0 0 1 0 0 0"),
    "cut short": (
        pcd("binary", WHOLE[:-1]),
        f"is a PCD that is cut short or damaged: {len(WHOLE) - 1} bytes of points, not {len(WHOLE)}",
    ),
    "few sizes": (pcd("binary", WHOLE, SIZE="4 4 4"), "is a PCD that is cut short or damaged"),
    "no numbers": (pcd("binary", WHOLE, COUNT="1 0 1 1 2"), "is a PCD that is cut short or damaged"),
    "few lines": (pcd("ascii", b"9 1 2 3 1 2\n"), "is a PCD that is cut short or damaged: 1 lines, not 3"),
    "few numbers": (pcd("ascii", b"9 1 2 3\n" * 3), "cut short or damaged: 4 numbers in a line, not 6"),
    "packed": (pcd("binary_compressed", struct.pack("<II", 3, 60) + b"\x20\0\0"), "60 bytes of points, not 48"),
    "copies": (pcd("binary_compressed", struct.pack("<II", 2, 48) + b"\x20\0"), "a copy of bytes before the first"),
}


@pytest.mark.parametrize(("content", "said"), WRONG_PCD.values(), ids=WRONG_PCD.keys())
def test_a_pcd_that_cannot_be_read_is_refused(content: bytes, said: str, tmp_path: Path) -> None:
    (tmp_path / "scan.pcd").write_bytes(content)
    with pytest.raises(InputError, match=rf"scan\.pcd: {said}|scan\.pcd: .*{said}"):
        read_points(tmp_path / "scan.pcd")


def test_a_pcd_of_32_bits_in_map_coordinates_is_refused(tmp_path: Path) -> None:
    far = [[x + 500_000.0, y + 5_400_000.0, z] for x, y, z in POINTS]
    (tmp_path / "scan.pcd").write_bytes(pcd("binary", rows_of(far)))
    with pytest.raises(InputError, match=r"floats of 32 bits, rounded to 0\.5 m so far from 0"):
        read_points(tmp_path / "scan.pcd", map_origin=(500_000, 5_400_000, 0))


def las(*records: tuple[int, bytes], minor: int = 2, form: int = 0, user: bytes = b"LASF_Projection") -> bytes:
    """Points at 500000 + 0.01 x, 5400000 + 0.01 y, 0.001 z, with 8 other bytes each."""
    listed = b"".join(struct.pack("<H16sHH32s", 0, user, number, len(data), b"") + data for number, data in records)
    size = 375 if minor >= 4 else 227
    numbers = [(round(100 * x), round(100 * y), round(1000 * z)) for x, y, z in POINTS]
    head = bytearray(size)
    head[:4], head[24:26] = b"LASF", bytes([1, minor])
    legacy = 0 if minor >= 4 else len(numbers)
    struct.pack_into("<HIIBHI", head, 94, size, size + len(listed), len(records), form, 20, legacy)
    struct.pack_into("<6d", head, 131, 0.01, 0.01, 0.001, 5e5, 5.4e6, 0.0)
    if minor >= 4:
        struct.pack_into("<Q", head, 247, len(numbers))
    return bytes(head) + listed + b"".join(struct.pack("<3i8x", *each) for each in numbers)


def keys(*pairs: tuple[int, int]) -> bytes:
    return struct.pack(f"<{4 + 4 * len(pairs)}H", 1, 1, 0, len(pairs), *(n for k, v in pairs for n in (k, 0, 1, v)))


@pytest.mark.parametrize("minor", [0, 2, 4])
def test_points_of_a_las_are_read_in_map_coordinates(minor: int, tmp_path: Path) -> None:
    (tmp_path / "scan.las").write_bytes(las((34735, keys((1024, 1), (3072, 25832))), minor=minor))
    found = read_points(tmp_path / "scan.las", map_origin=(500_000, 5_400_000, 0))
    np.testing.assert_allclose(found, POINTS, atol=2e-9)
    with pytest.raises(InputError, match=r"`map_origin: \[499998, 5400005, 4\]`"):
        read_points(tmp_path / "scan.las", map_origin=(0, 0, 0))


def test_coordinates_that_no_map_in_metres_has_are_told_to_be_of_other_units(tmp_path: Path) -> None:
    """A northing of 5,400 km is 17,716,535 feet."""
    (tmp_path / "scan.xyz").write_text("1640420 17716535 13\n1640421 17716535 13\n")
    with pytest.raises(InputError, match=r"up to 17,716,535, which no map in metres has: they may be feet"):
        read_points(tmp_path / "scan.xyz", map_origin=(500_000, 5_400_000, 0))


WRONG_LAS = {
    "degrees": (las((34735, keys((1024, 2), (2048, 4326)))), "its reference system: is in degrees"),
    "feet": (las((34735, keys((1024, 1), (3072, 2229)))), "its reference system: is not in metres; found EPSG 2229"),
    "heights in feet": (
        las((34735, keys((1024, 1), (3072, 25832), (4099, 9002)))),
        "its reference system: its heights are not in metres",
    ),
    "WKT": (
        las((2112, b'GEOGCS["WGS 84",UNIT["degree",0.0174532925199433]]\0'), minor=4),
        "its WKT record: is in deg.*pdal",
    ),
    "a LAZ without its record": (las(form=0x80), "is a LAS that is cut short or damaged: its table of chunks"),
    "no LAS": (b"LASX" + las()[4:], "is not a LAS; found b'LASX'"),
    "cut short": (las()[:-1], "is a LAS that is cut short or damaged"),
    "cut in its header": (las()[:100], "is a LAS that is cut short or damaged"),
}


@pytest.mark.parametrize(("content", "said"), WRONG_LAS.values(), ids=WRONG_LAS.keys())
def test_a_las_that_cannot_be_read_or_is_not_in_metres_is_refused(content: bytes, said: str, tmp_path: Path) -> None:
    (tmp_path / "scan.las").write_bytes(content)
    with pytest.raises(InputError, match=rf"scan\.las: {said}"):
        read_points(tmp_path / "scan.las")


def test_records_of_others_in_a_las_are_not_looked_at(tmp_path: Path) -> None:
    (tmp_path / "scan.las").write_bytes(las((34735, keys((1024, 2))), user=b"somebody"))
    np.testing.assert_allclose(read_points(tmp_path / "scan.las", map_origin=(5e5, 5.4e6, 0)), POINTS, atol=2e-9)


def laz(version: str, form: int, points: list[list[float]] | np.ndarray, path: Path) -> bytes:
    """A LAZ with points to a millimetre, by laspy."""
    header = laspy.LasHeader(version=version, point_format=form)
    header.scales, header.offsets = [0.001] * 3, [5e5, 5.4e6, 0.0]
    scan = laspy.LasData(header)
    scan.x, scan.y, scan.z = np.asarray(points).T + np.array([[5e5], [5.4e6], [0.0]])
    scan.write(path)
    return path.read_bytes()


@pytest.mark.parametrize("ending", ["las", "laz"])
@pytest.mark.parametrize(("version", "form"), [("1.2", 3), ("1.4", 6)])
def test_points_that_a_las_marks_as_noise_or_withheld_do_not_count(
    version: str, form: int, ending: str, tmp_path: Path
) -> None:
    """Ground, low noise, a building, high noise (from point format 6 on), a withheld point, and low noise again."""
    header = laspy.LasHeader(version=version, point_format=form)
    header.scales = [0.001] * 3
    scan = laspy.LasData(header)
    scan.x, scan.y, scan.z = np.arange(6.0), np.zeros(6), np.zeros(6)
    scan.classification = [2, 7, 6, 18, 2, 7]
    scan.withheld = [0, 0, 0, 0, 1, 0]
    scan.synthetic = [1, 0, 1, 0, 0, 1]
    scan.write(tmp_path / f"scan.{ending}")
    assert read_points(tmp_path / f"scan.{ending}")[:, 0].tolist() == ([0.0, 2.0] if form == 6 else [0.0, 2.0, 3.0])


@pytest.mark.parametrize(("version", "form"), [("1.2", 3), ("1.4", 6)])
def test_points_of_a_laz_are_those_that_laspy_wrote(version: str, form: int, tmp_path: Path) -> None:
    """60,000 points take two chunks."""
    points = np.random.default_rng(3).uniform(-40.0, 40.0, (60_000, 3))
    content = laz(version, form, points, tmp_path / "scan.laz")
    found = read_points(tmp_path / "scan.laz", map_origin=(5e5, 5.4e6, 0))
    np.testing.assert_allclose(found, points, atol=5.1e-4)
    begin = struct.unpack_from("<I", content, 96)[0]
    (table,) = struct.unpack_from("<q", content, begin)
    streamed = content[:begin] + struct.pack("<q", -1) + content[begin + 8 :] + struct.pack("<q", table)
    (tmp_path / "stream.laz").write_bytes(streamed)
    np.testing.assert_array_equal(read_points(tmp_path / "stream.laz", map_origin=(5e5, 5.4e6, 0)), found)
    wrong = {
        "cut": content[: len(content) // 2],
        "table beyond the end": content[:begin] + struct.pack("<q", 10**9) + content[begin + 8 :],
        "4 billion chunks": content[: table + 4] + b"\xff" * 4 + content[table + 8 :],
        "other bytes": content[: begin + 900] + bytes(9000) + content[begin + 9900 :],
    }
    if form == 6:  # the first layer follows the first point, of 30 bytes, and the number of points
        wrong["a layer of 4 GB"] = content[: begin + 42] + b"\xff" * 4 + content[begin + 46 :]
    for changed in wrong.values():
        (tmp_path / "wrong.laz").write_bytes(changed)
        with pytest.raises(InputError, match=r"wrong\.laz: .*(cut short or damaged|is too large)"):
            read_points(tmp_path / "wrong.laz", map_origin=(5e5, 5.4e6, 0))


def with_another_count(content: bytes, count: int) -> bytes:
    """An E57 whose first scan says that it has 9 points: pages of 1,024 bytes, each with its checksum (CRC-32C)."""
    table = []
    for byte in range(256):
        for _ in range(8):
            byte = (byte >> 1) ^ (0x82F63B78 if byte & 1 else 0)
        table.append(byte)
    plain = b"".join(content[at : at + 1020] for at in range(0, len(content), 1024))
    plain = plain.replace(f'recordCount="{count}"'.encode(), b'recordCount="9"', 1)
    found = b""
    for at in range(0, len(plain), 1020):
        check = 0xFFFFFFFF
        for one in plain[at : at + 1020]:
            check = (check >> 8) ^ table[(check ^ one) & 0xFF]
        found += plain[at : at + 1020] + struct.pack(">I", check ^ 0xFFFFFFFF)
    return found


def test_points_of_an_e57_are_at_the_poses_of_its_scanners(tmp_path: Path) -> None:
    """The second scanner is turned by a quarter to the left, and stands at 10, 0, 1."""
    pye57 = pytest.importorskip("pye57")
    columns = {f"cartesian{axis}": column for axis, column in zip("XYZ", np.array(POINTS).T, strict=True)}
    with pye57.E57(str(tmp_path / "scan.e57"), mode="w") as scans:
        scans.write_scan_raw(columns)
        half = np.pi / 4.0
        scans.write_scan_raw(
            columns, rotation=np.array([np.cos(half), 0.0, 0.0, np.sin(half)]), translation=np.array([10.0, 0.0, 1.0])
        )
    turned = [[10.0 - y, x, z + 1.0] for x, y, z in POINTS]
    np.testing.assert_allclose(read_points(tmp_path / "scan.e57"), [*POINTS, *turned], atol=1e-12)
    (tmp_path / "more.e57").write_bytes(with_another_count((tmp_path / "scan.e57").read_bytes(), len(POINTS)))
    with pytest.raises(InputError, match=rf"scan 1: is cut short or damaged; found {len(POINTS)} points; allowed: 9,"):
        read_points(tmp_path / "more.e57")
    with pye57.E57(str(tmp_path / "none.e57"), mode="w") as scans:
        scans.write_scan_raw(columns, rotation=np.zeros(4), translation=np.zeros(3))
    with pytest.raises(InputError, match=r"scan 1, pose, rotation: is no pose of a scanner; found \[0\.0, 0\.0"):
        read_points(tmp_path / "none.e57")
    far = {name: column + 5.4e6 for name, column in columns.items()}  # written as floats of 32 bits, as pye57 does
    with pye57.E57(str(tmp_path / "far.e57"), mode="w") as scans:
        scans.write_scan_raw(far)
    with pytest.raises(InputError, match=r"far\.e57: its coordinates are floats of 32 bits, rounded to 0\.5 m"):
        read_points(tmp_path / "far.e57", map_origin=(5.4e6, 5.4e6, 5.4e6))
    (tmp_path / "scan.e57").write_bytes((tmp_path / "scan.e57").read_bytes()[:900])
    with pytest.raises(InputError, match=r"scan\.e57: cannot be read as an E57: "):
        read_points(tmp_path / "scan.e57")


def test_scans_are_obstacles_and_ground(planar4: Robot, tmp_path: Path) -> None:
    """Three voxels of 0.5 m, one around each point."""
    (tmp_path / "scan.pcd").write_bytes(pcd("binary", WHOLE))
    record = {"name": "scan", "shape": "pointcloud", "file": "scan.pcd", "resolution": 0.5}
    found = build_obstacle(obstacle_from_dict(record), folder=tmp_path, clearance=0.1)
    np.testing.assert_allclose(found.bounds, [[-7.0, 2.5, 3.5], [4.5, 8.5, 9.5]], atol=1e-9)
    ground = Terrain.from_file(tmp_path / "scan.pcd", low=(-8.0, 2.0), high=(5.0, 9.0), cell=1.0, fill=20.0)
    assert ground.surface.max() == pytest.approx(9.25)


OTHERS = {
    "scan.rcp": (b"RCP", r"is a \.rcp file, which is not read; allowed: text with x, y, z.* makes an E57 or LAZ of it"),
    "scan.laz": (b"LASF", r"is a LAS that is cut short or damaged"),
    "scan.e57": (b"ASTM-E57" + bytes(100), r"cannot be read as an E57: "),
    "scan.glb": (b"glTF", r"is a \.glb file, which is not read; .* or it is a mesh"),
    "scan.off": (b"OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n", r"is a \.off file, which is not read"),
    "scan.asc": (b"ncols 3\nnrows 1\n1 2 3\n", "line 1: is an ESRI grid of heights, not a list of points"),
    "scan.xyz": (b"LASF\0\0\0\0", "is not text: it has bytes of 0"),
}


@pytest.mark.parametrize(("name", "content", "said"), [(name, *rest) for name, rest in OTHERS.items()], ids=OTHERS)
def test_files_that_are_no_points_are_refused(name: str, content: bytes, said: str, tmp_path: Path) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError, match=said):
        read_points(tmp_path / name)


def test_longitude_and_latitude_are_refused_and_a_thin_pole_is_not(tmp_path: Path) -> None:
    """A hundred points within 100 m are within 0.001 degrees; a pole of 5 m and 2 cm is 250 times as high as wide."""
    rng = np.random.default_rng(5)
    places = np.column_stack(
        (11.5 + rng.uniform(0, 1e-3, 100), 48.1 + rng.uniform(0, 1e-3, 100), rng.uniform(0, 9, 100))
    )
    np.savetxt(tmp_path / "scan.xyz", places, fmt="%.9f")
    with pytest.raises(InputError, match=r"scan\.xyz: looks like degrees; found .* along z, at 11\.5.*UTM"):
        read_points(tmp_path / "scan.xyz")
    pole = np.column_stack((rng.uniform(0, 0.02, (100, 2)), np.linspace(0, 5, 100)))
    np.savetxt(tmp_path / "pole.xyz", pole, fmt="%.9f")
    np.testing.assert_allclose(read_points(tmp_path / "pole.xyz"), pole, atol=1e-9)
