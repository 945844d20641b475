"""GeoTIFFs written by hand, byte by byte: numbers of every kind, masks, units by code, and what is refused."""

from __future__ import annotations

import itertools
import struct
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest

from backhoe_planner.arrays import Array, Matrix
from backhoe_planner.errors import InputError
from backhoe_planner.site import build_obstacle, obstacle_from_dict, read_height_grid, read_heights

NAN = float("nan")
SHORT, LONG, DOUBLE, TEXT, LONG8 = 3, 4, 12, 2, 16
FORMATS = {SHORT: "H", LONG: "I", DOUBLE: "d", LONG8: "Q"}
HEIGHTS = np.array([[10.5, 11.0, -12.25], [0.1, 1e-3, 900.0], [1.0, 2.0, 3.0], [4.0, 5.0, 6.0], [7.0, 8.0, 9.0]])


def image(
    heights: Array, *, kind: str = "<f8", deflated: bool = False, predictor: int = 1, rows: int = 2,
    tile: int | None = None, left_out: Sequence[int] = (), tags: dict[int, tuple[int, Any]] | None = None,
) -> tuple[dict[int, tuple[int, Any]], list[bytes]]:  # fmt: skip
    """The tags and blocks of an image with strips of some rows, or with square tiles; rows are ascending in y."""
    stored = heights[::-1].astype(kind)
    high, wide = (rows, stored.shape[1]) if tile is None else (tile, tile)
    blocks = list[bytes]()
    for row in range(0, stored.shape[0], high):
        for column in range(0, stored.shape[1], wide):
            part = stored[row : row + high, column : column + wide]
            if tile is not None:
                part = np.pad(part, [(0, tile - part.shape[0]), (0, tile - part.shape[1])])
            data = encoded(part.astype(kind), predictor)
            blocks.append(b"" if len(blocks) in left_out else zlib.compress(data) if deflated else data)
    size = np.dtype(kind).itemsize
    found: dict[int, tuple[int, Any]] = {
        256: (SHORT, heights.shape[1]), 257: (SHORT, heights.shape[0]), 258: (SHORT, 8 * size),
        259: (SHORT, 8 if deflated else 1), 262: (SHORT, 1), 277: (SHORT, 1), 317: (SHORT, predictor),
        339: (SHORT, {"u": 1, "i": 2, "f": 3}[np.dtype(kind).kind]),
    }  # fmt: skip
    found |= {278: (SHORT, high)} if tile is None else {322: (SHORT, wide), 323: (SHORT, high)}
    return found | (tags or {}), blocks


def encoded(part: Array, predictor: int) -> bytes:
    """The rows of a strip as the standard has them: plain, as differences, or as differences of bytes."""
    size = part.dtype.itemsize
    byteorder: Literal["little", "big"] = "big" if part.dtype.str.startswith(">") else "little"
    if predictor == 1:
        return part.tobytes()
    lines = []
    for row in part:
        raw = row.tobytes()
        numbers = [raw[at : at + size] for at in range(0, len(raw), size)]
        if predictor == 2:
            whole = [0, *(int.from_bytes(number, byteorder) for number in numbers)]
            steps = [(b - a) % 256**size for a, b in itertools.pairwise(whole)]
            lines += [step.to_bytes(size, byteorder) for step in steps]
        else:
            most_significant_first = [number if byteorder == "big" else number[::-1] for number in numbers]
            mixed = [0, *(number[byte] for byte in range(size) for number in most_significant_first)]
            lines.append(bytes((b - a) % 256 for a, b in itertools.pairwise(mixed)))
    return b"".join(lines)


def write_tiff(
    path: Path, *images: tuple[dict[int, tuple[int, Any]], list[bytes]], order: str = "<", is_big: bool = False
) -> Path:
    content = bytearray(struct.pack(f"{order}2sH", b"II" if order == "<" else b"MM", 43 if is_big else 42))
    word, number = ("Q", LONG8) if is_big else ("I", LONG)
    content += struct.pack(f"{order}HH", 8, 0) if is_big else b""
    link = len(content)
    content += bytes(struct.calcsize(word))
    for tags, blocks in images:
        offsets = []
        for block in blocks:
            offsets.append(len(content) if block else 0)
            content += block
        places = (324, 325) if 322 in tags else (273, 279)
        tags |= {places[0]: (number, tuple(offsets)), places[1]: (number, tuple(map(len, blocks)))}
        entries = []
        for tag, (kind, value) in sorted(tags.items()):
            values = value if isinstance(value, tuple) else (value,)
            data = value.encode() if kind == TEXT else struct.pack(f"{order}{len(values)}{FORMATS[kind]}", *values)
            count, room = len(data) if kind == TEXT else len(values), struct.calcsize(word)
            if len(data) > room:
                content, data = content + data, struct.pack(order + word, len(content))
            entries.append(struct.pack(f"{order}HH{word}", tag, kind, count) + data.ljust(room, b"\0"))
        struct.pack_into(order + word, content, link, len(content))
        content += struct.pack(order + ("Q" if is_big else "H"), len(entries)) + b"".join(entries)
        link = len(content)
        content += bytes(struct.calcsize(word))
    path.write_bytes(content)
    return path


def placed(keys: dict[int, int], words: str | None = None) -> dict[int, tuple[int, Any]]:
    """The tags of a location, and of keys."""
    listed = [(1, 1, 0, len(keys)), *((key, 0, 1, value) for key, value in sorted(keys.items()))]
    found: dict[int, tuple[int, Any]] = {
        33550: (DOUBLE, (0.5, 0.5, 0.0)), 33922: (DOUBLE, (0.0, 0.0, 0.0, 6e5, 5.4e6, 0.0)),
        34735: (SHORT, tuple(value for key in listed for value in key)),
    }  # fmt: skip
    return found if words is None else found | {34737: (TEXT, words)}


@pytest.mark.parametrize("is_big", [False, True])
@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("tile", [None, 2])
@pytest.mark.parametrize(("deflated", "predictor"), [(False, 1), (True, 1), (True, 2), (True, 3)])
def test_floats_of_64_bits_are_read(
    deflated: bool, predictor: int, tile: int | None, order: str, is_big: bool, tmp_path: Path
) -> None:
    picture = image(HEIGHTS, kind=f"{order}f8", deflated=deflated, predictor=predictor, tile=tile)
    file = write_tiff(tmp_path / "a.tif", picture, order=order, is_big=is_big)
    np.testing.assert_array_equal(read_heights(file), HEIGHTS)


@pytest.mark.parametrize("kind", ["u1", "<u2", ">u2", "<i2", "<u4", ">i4", "<i8", "<f2", ">f4"])
def test_numbers_of_other_sizes_are_read(kind: str, tmp_path: Path) -> None:
    heights = np.array([[1.0, 0.0], [2.0, 100.0], [3.0, 7.0]]) * (1.0 if "u" in kind else -1.0)
    for predictor in (1, 2):
        picture = image(heights, kind=kind, deflated=True, predictor=predictor)
        file = write_tiff(tmp_path / "a.tif", picture, order=kind[0].replace("u", "<"))
        np.testing.assert_array_equal(read_heights(file), heights)


def test_a_signalling_nan_is_a_missing_height(tmp_path: Path) -> None:
    """Numbers that are turned into floats of 64 bits: such a NaN of 32 bits is one without the highest bit."""
    tags, blocks = image(np.ones((2, 2)), kind="<f4")
    file = write_tiff(tmp_path / "a.tif", (tags, [struct.pack("<I", 0x7F800001) + blocks[0][4:]]))
    np.testing.assert_array_equal(read_height_grid(file).heights, [[1.0, 1.0], [NAN, 1.0]])


def hidden(heights: Matrix, *places: tuple[int, int]) -> Matrix:
    found = heights.copy()
    found[tuple(zip(*places, strict=True))] = NAN
    return found


def test_a_mask_hides_heights(tmp_path: Path) -> None:
    """As GDAL writes it: one bit a height, in a second image; a bit of 1 is shown."""
    bits = np.array([[0b11000000], [0b11100000], [0b01100000], [0b11100000], [0b11100000]], dtype=float)
    mask, blocks = image(bits, kind="u1", deflated=True, rows=5)
    mask |= {254: (LONG, 4), 256: (SHORT, 3), 258: (SHORT, 1), 262: (SHORT, 4)}
    overview = image(np.zeros((2, 2)), tags={254: (LONG, 1)})
    file = write_tiff(tmp_path / "a.tif", image(HEIGHTS), overview, (mask, blocks))
    np.testing.assert_array_equal(read_height_grid(file).heights, hidden(HEIGHTS, (0, 2), (2, 0)))
    with pytest.raises(InputError, match="row 1, column 3: a height is missing"):
        read_heights(file)
    (tmp_path / "a.tif.msk").touch()
    with pytest.raises(InputError, match=r"has a mask in another file, which is not read; found a\.tif\.msk"):
        read_height_grid(file)


def test_tiles_that_are_left_out_are_holes(tmp_path: Path) -> None:
    """Of 5 rows and 3 columns in tiles of 2 x 2, the fourth tile is in the north-east but for two rows."""
    file = write_tiff(tmp_path / "a.tif", image(HEIGHTS, tile=2, left_out=[3]))
    np.testing.assert_array_equal(read_height_grid(file).heights, hidden(HEIGHTS, (1, 2), (2, 2)))


FEET, METRES = "is not in metres", None
CODES = {
    "UTM zone 32N": ({1024: 1, 3072: 32632}, METRES),
    "ETRS89 UTM zone 33N": ({1024: 1, 3072: 25833}, METRES),
    "Swiss LV95": ({1024: 1, 3072: 2056}, METRES),
    "Gauss-Krueger zone 3": ({1024: 1, 3072: 31467}, METRES),
    "British grid": ({1024: 1, 3072: 27700}, METRES),
    "Lambert-93": ({1024: 1, 3072: 2154}, METRES),
    "Krovak": ({1024: 1, 3072: 5514}, METRES),
    "web Mercator": ({1024: 1, 3072: 3857}, METRES),
    "California zone 5, US survey feet": ({1024: 1, 3072: 2229}, FEET),
    "Arizona Central, international feet": ({1024: 1, 3072: 2223}, FEET),
    "New York Long Island, US survey feet": ({1024: 1, 3072: 2263}, FEET),
    "Gold Coast feet": ({1024: 1, 3072: 2136}, FEET),
    "feet by their code, metres by their key": ({1024: 1, 3072: 2229, 3076: 9001}, FEET),
    "an unknown code": ({1024: 1, 3072: 64000}, "does not say that it is in metres.*EPSG 64000.*ProjLinearUnits"),
    "an unknown code with its unit": ({1024: 1, 3072: 64000, 3076: 9001}, METRES),
    "a system of one's own": ({1024: 1, 3072: 32767, 3076: 9001}, METRES),
    "a geographic system": ({2048: 4326}, "is in degrees"),
    "geocentric": ({1024: 3}, "from the centre of the earth"),
    "NAVD88 height": ({1024: 1, 3072: 32610, 4096: 5703}, METRES),
    "DHHN2016 height": ({1024: 1, 3072: 25832, 4096: 7837}, METRES),
    "NAVD88 height in US survey feet": ({1024: 1, 3072: 32610, 4096: 6360}, "heights are not in metres.*EPSG 6360"),
    "NAVD88 height in feet": ({1024: 1, 3072: 32610, 4096: 8228, 4099: 9001}, "heights are not in metres.*EPSG 8228"),
    "LAT depth": ({1024: 1, 3072: 25832, 4096: 5861}, "heights are not in metres upwards; .*EPSG 5861"),
    "an unknown vertical code": ({1024: 1, 3072: 25832, 4096: 64000}, "does not say that its heights.*VerticalUnits"),
    "an unknown vertical code with its unit": ({1024: 1, 3072: 25832, 4096: 64000, 4099: 9001}, METRES),
}  # fmt: skip


@pytest.mark.parametrize(("keys", "said"), CODES.values(), ids=CODES.keys())
def test_units_follow_from_the_code_of_the_reference_system(
    keys: dict[int, int], said: str | None, tmp_path: Path
) -> None:
    file = write_tiff(tmp_path / "a.tif", image(HEIGHTS, tags=placed(keys)))
    if said is None:
        found = read_height_grid(file)
        np.testing.assert_array_equal(found.heights, HEIGHTS)
        np.testing.assert_allclose(np.array(found.low), [6e5 + 0.25, 5.4e6 - 2.25])
    else:
        with pytest.raises(InputError, match=said):
            read_height_grid(file)


def test_feet_in_the_text_of_a_projection_are_refused(tmp_path: Path) -> None:
    words = 'ESRI PE String = PROJCS["Site",UNIT["Foot_US",0.3048006096012192]]|'
    file = write_tiff(tmp_path / "a.tif", image(HEIGHTS, tags=placed({1024: 1, 3072: 32767}, words)))
    with pytest.raises(InputError, match="is not in metres; found ESRI PE String"):
        read_height_grid(file)


@pytest.mark.parametrize(("unit", "is_read"), [("m", True), ("metre", True), ("ft", False), ("US survey foot", False)])
def test_the_unit_of_the_band_must_be_the_metre(unit: str, is_read: bool, tmp_path: Path) -> None:
    """In the tag of GDAL, or in the file that it writes beside."""
    item = f'<GDALMetadata><Item name="UNITTYPE" sample="0" role="unittype">{unit}</Item></GDALMetadata>'
    write_tiff(tmp_path / "tag.tif", image(HEIGHTS, tags={42112: (TEXT, item)}))
    write_tiff(tmp_path / "beside.tif", image(HEIGHTS))
    band = f'<PAMDataset><PAMRasterBand band="1"><UnitType>{unit}</UnitType></PAMRasterBand></PAMDataset>'
    (tmp_path / "beside.tif.aux.xml").write_text(band, encoding="utf-8")
    for name in ("tag.tif", "beside.tif"):
        if is_read:
            np.testing.assert_array_equal(read_heights(tmp_path / name), HEIGHTS)
        else:
            with pytest.raises(InputError, match=f"UnitType: its heights are not in metres; found {unit}"):
                read_heights(tmp_path / name)


def test_scale_offset_and_missing_heights_are_taken_from_the_file_beside(tmp_path: Path) -> None:
    file = write_tiff(tmp_path / "a.tif", image(np.array([[10.0, -7777.0], [20.0, 30.0]])))
    beside = file.with_name("a.tif.aux.xml")
    band = '<PAMDataset><PAMRasterBand band="1"><NoDataValue>-7.777E+03</NoDataValue><Scale>0.1</Scale>{}'
    end = "<Offset>5</Offset></PAMRasterBand><PAMRasterBand band='2'><Scale>9</Scale></PAMRasterBand></PAMDataset>"
    beside.write_text(band.format(end), encoding="utf-8")
    np.testing.assert_allclose(read_height_grid(file).heights, [[6.0, NAN], [7.0, 8.0]], atol=1e-12)
    write_tiff(file, image(np.array([[10.0, -7777.0], [20.0, 30.0]]), tags={42113: (TEXT, "-7777")}))
    np.testing.assert_allclose(read_height_grid(file).heights, [[6.0, NAN], [7.0, 8.0]], atol=1e-12)
    write_tiff(file, image(np.ones((2, 2)), tags={42113: (TEXT, "-9999")}))
    with pytest.raises(InputError, match=r"NoDataValue: says two things; found -9999, and -7\.777E\+03 in a\.tif\.aux"):
        read_height_grid(file)


REFUSED: dict[str, tuple[dict[int, tuple[int, Any]], str]] = {
    "LERC": ({258: (SHORT, 32), 259: (SHORT, 34887)}, "compression that cannot be read; found compression LERC"),
    "64 bits, LZW": ({259: (SHORT, 5)}, "has numbers of 64 bits; found compression LZW.*gdal_translate -ot Float32"),
    "complex": ({339: (SHORT, 6)}, "has numbers that cannot be read; found 64 bits, sample format 6"),
    "12 bits": ({258: (SHORT, 12), 339: (SHORT, 1)}, "has numbers that cannot be read; found 12 bits"),
    "3 bands": ({277: (SHORT, 3)}, "is not a height map; found 3 bands; allowed: one band of numbers"),
    "a palette": ({262: (SHORT, 3)}, "is not a height map; found a palette of colours"),
    "too large": ({256: (LONG, 100_000), 257: (LONG, 100_000)}, "is too large"),
    "a strip missing": ({278: (SHORT, 1)}, "strips or tiles are missing"),
    "no width": ({256: (SHORT, 0)}, "its size is not given"),
}


@pytest.mark.parametrize(("tags", "said"), REFUSED.values(), ids=REFUSED.keys())
def test_numbers_that_cannot_be_read_are_refused(tags: dict[int, tuple[int, Any]], said: str, tmp_path: Path) -> None:
    file = write_tiff(tmp_path / "a.tif", image(HEIGHTS, tags=tags))
    with pytest.raises(InputError, match=rf"a\.tif: .*{said}"):
        read_heights(file)


def test_a_big_endian_file_in_a_compression_that_needs_pillow_is_refused(tmp_path: Path) -> None:
    """Pillow reads its numbers as little-endian ones."""
    file = write_tiff(tmp_path / "a.tif", image(HEIGHTS, kind=">f4", tags={259: (SHORT, 5)}), order=">")
    with pytest.raises(InputError, match=r"is compressed in big-endian order; found compression LZW.*gdal_translate"):
        read_heights(file)


def test_several_images_in_a_file_are_refused(tmp_path: Path) -> None:
    file = write_tiff(tmp_path / "a.tif", image(HEIGHTS), image(HEIGHTS))
    with pytest.raises(InputError, match="holds several images; found 2 images; allowed: one, its mask and overviews"):
        read_heights(file)


@pytest.mark.parametrize("deflated", [False, True])
def test_a_file_cut_anywhere_is_refused(deflated: bool, tmp_path: Path) -> None:
    whole = write_tiff(tmp_path / "whole.tif", image(HEIGHTS, deflated=deflated, tags=placed({1024: 1}))).read_bytes()
    file = tmp_path / "a.tif"
    for length in range(1, len(whole), 7):
        file.write_bytes(whole[:length])
        with pytest.raises(InputError, match=r"a\.tif"):
            read_height_grid(file)


@pytest.mark.parametrize("tag", [256, 258, 262, 273, 277, 278, 279, 339, 34735])
@pytest.mark.parametrize(("at", "value"), [(2, TEXT), (2, DOUBLE), (4, 0)], ids=["text", "fraction", "no value"])
def test_a_tag_of_another_type_or_without_a_value_is_refused(tag: int, at: int, value: int, tmp_path: Path) -> None:
    content = bytearray(write_tiff(tmp_path / "a.tif", image(HEIGHTS, tags=placed({1024: 1}))).read_bytes())
    (begin,) = struct.unpack_from("<I", content, 4)
    (count,) = struct.unpack_from("<H", content, begin)
    entries = range(begin + 2, begin + 2 + 12 * count, 12)
    (entry,) = [entry for entry in entries if struct.unpack_from("<H", content, entry) == (tag,)]
    struct.pack_into("<H" if at == 2 else "<I", content, entry + at, value)
    (tmp_path / "a.tif").write_bytes(content)
    with pytest.raises(InputError, match=r"a\.tif: is not a TIFF that can be read"):
        read_height_grid(tmp_path / "a.tif")


def test_terrain_in_use_is_read_again_when_a_file_beside_it_changes(tmp_path: Path) -> None:
    """A scale of 2 is written beside heights of up to 3 m while they are in use."""
    heights = np.zeros((15, 15))
    heights[7, 7] = 3.0
    write_tiff(tmp_path / "hill.tif", image(heights))
    record = {"name": "hill", "shape": "heightmap", "file": "hill.tif", "size": [14, 14]}
    first = build_obstacle(obstacle_from_dict(record), folder=tmp_path, clearance=0.1)
    assert first.cluster is not None
    band = '<PAMDataset><PAMRasterBand band="1"><Scale>2</Scale></PAMRasterBand></PAMDataset>'
    (tmp_path / "hill.tif.aux.xml").write_text(band, encoding="utf-8")
    second = build_obstacle(obstacle_from_dict(record), folder=tmp_path, clearance=0.1)
    assert (first.bounds[1, 2], second.bounds[1, 2]) == pytest.approx((3.0, 6.0), abs=1e-9)


UTM = (
    'PROJCS["ETRS_1989_UTM_Zone_32N",GEOGCS["GCS_ETRS_1989",DATUM["D_ETRS_1989",SPHEROID["GRS_1980",6378137.0,298.26]],'
    'PRIMEM["Greenwich",0.0],UNIT["Degree",0.0174532925199433]],PROJECTION["Transverse_Mercator"],'
    'PARAMETER["False_Easting",500000.0],UNIT["{}",{}]]'
)
METRE, FOOT = UTM.format("Meter", "1.0"), UTM.format("Foot_US", "0.304800609601219")
DEGREES = 'GEOGCS["GCS_WGS_1984",DATUM["D",SPHEROID["S",6378137.0,298.26]],UNIT["Degree",0.0174532925199433]]'
UTM_2 = (
    'PROJCRS["UTM",BASEGEOGCRS["WGS 84",DATUM["W",ELLIPSOID["W",6378137,298.26,LENGTHUNIT["metre",1]]]],CONVERSION["z",'
    'PARAMETER["False easting",500000,LENGTHUNIT["metre",1]]],CS[Cartesian,2],AXIS["(E)",east],AXIS["(N)",north],{}]'
)
HEIGHTS_OF = ',VERTCS["EGM96",VDATUM["E"],PARAMETER["Direction",{}],UNIT["{}",{}]]'


def world_file(path: Path, *numbers: float) -> None:
    path.write_text("".join(f"{number}\n" for number in numbers), encoding="utf-8")


def noted(path: Path, transform: str, system: str) -> None:
    text = f"<PAMDataset><SRS>{system}</SRS><GeoTransform>{transform}</GeoTransform></PAMDataset>"
    path.with_name(path.name + ".aux.xml").write_text(text, encoding="utf-8")


@pytest.mark.parametrize("name", ["a.tfw", "a.TFW", "a.tifw", "a.wld"])
def test_a_world_file_places_the_middle_of_the_first_cell(name: str, tmp_path: Path) -> None:
    """Five rows of 0.5 m from 5.4e6 m on southwards: the last one is 2 m further south."""
    file = write_tiff(tmp_path / "a.tif", image(HEIGHTS))
    world_file(tmp_path / name, 0.5, 0.0, 0.0, -0.5, 6e5, 5.4e6)
    found = read_height_grid(file)
    np.testing.assert_allclose(np.array(found.low), [6e5, 5.4e6 - 2.0])
    assert found.cell == 0.5
    np.testing.assert_array_equal(read_heights(file, size=(1.0, 2.0)), HEIGHTS)
    with pytest.raises(InputError, match=r"a\.tif: size: is of another size than the scene says; found \[10, 20\]"):
        read_heights(file, size=(10.0, 20.0))


def test_gdal_notes_the_corner_of_the_first_cell_beside_the_file(tmp_path: Path) -> None:
    file = write_tiff(tmp_path / "a.tif", image(HEIGHTS))
    noted(file, "6.0e5, 0.5, 0.0, 5.4e6, 0.0, -0.5", "EPSG:25832")
    np.testing.assert_allclose(np.array(read_height_grid(file).low), [6e5 + 0.25, 5.4e6 - 2.25])
    noted(file, "6.0e5, 0.5, 0.0, 5.4e6, 0.0, -0.5", DEGREES.replace('"', "&quot;"))
    with pytest.raises(InputError, match=r"a\.tif: SRS in its \.aux\.xml: is in degrees"):
        read_height_grid(file)


def test_places_that_differ_are_refused_and_equal_ones_are_not(tmp_path: Path) -> None:
    """The corner in the tags is half a cell from the middle in the world file."""
    file = write_tiff(tmp_path / "a.tif", image(HEIGHTS, tags=placed({1024: 1, 3072: 25832})))
    world_file(tmp_path / "a.tfw", 0.5, 0.0, 0.0, -0.5, 6e5 + 0.25, 5.4e6 - 0.25)
    np.testing.assert_allclose(np.array(read_height_grid(file).low), [6e5 + 0.25, 5.4e6 - 2.25])
    world_file(tmp_path / "a.tfw", 0.5, 0.0, 0.0, -0.5, 6e5 + 7.25, 5.4e6 - 0.25)
    with pytest.raises(InputError, match=r"says two things; found 600000\.25, .* in its tags and 600007\.25.*a\.tfw"):
        read_height_grid(file)


WRONG_PLACES = {
    "degrees": (
        (1e-5, 0.0, 0.0, -1e-5, 11.5, 48.1),
        r"a\.tif: may be in degrees; found cells of 1e-05 at 11\.5, 48\.1",
    ),
    "turned": ((0.5, 0.1, 0.1, -0.5, 6e5, 5.4e6), r"a\.tif: is turned against north"),
    "oblong": ((0.5, 0.0, 0.0, -0.6, 6e5, 5.4e6), r"a\.tif: its cells are not square; found 0\.5 x 0\.6 m"),
    "flipped": ((0.5, 0.0, 0.0, 0.5, 6e5, 5.4e6), r"a\.tif: is flipped; found rows from south to north"),
    "five numbers": ((0.5, 0.0, 0.0, -0.5, 6e5), r"a\.tfw: its lines: is not a place; .*allowed: six numbers"),
    "not finite": ((0.5, 0.0, 0.0, -0.5, 6e5, NAN), r"a\.tfw: its lines: is not a place"),
}


@pytest.mark.parametrize(("numbers", "said"), WRONG_PLACES.values(), ids=WRONG_PLACES.keys())
def test_a_world_file_that_says_no_place_in_metres_is_refused(
    numbers: tuple[float, ...], said: str, tmp_path: Path
) -> None:
    file = write_tiff(tmp_path / "a.tif", image(HEIGHTS))
    world_file(tmp_path / "a.tfw", *numbers)
    with pytest.raises(InputError, match=said):
        read_height_grid(file)


SYSTEMS = {
    "metres": (METRE, None),
    "US feet": (FOOT, r"is not in metres; found Foot_US 0\.304800609601219; allowed: metres"),
    "degrees": (DEGREES, "is in degrees"),
    "WKT 2, metres": (UTM_2.format('LENGTHUNIT["metre",1]'), None),
    "WKT 2, feet": (UTM_2.format('LENGTHUNIT["foot",0.3048]'), r"is not in metres; found foot 0\.3048"),
    "heights": (METRE + HEIGHTS_OF.format("1.0", "Meter", "1.0"), None),
    "heights in feet": (
        METRE + HEIGHTS_OF.format("1.0", "Foot", "0.3048"),
        "its heights are not in metres; found Foot",
    ),
    "depths": (METRE + HEIGHTS_OF.format("-1.0", "Meter", "1.0"), "its heights are depths"),
    "down": ('COMPD_CS["x",' + METRE + ',VERT_CS["v",UNIT["metre",1],AXIS["D",DOWN]]]', "its heights are depths"),
    "a code in metres": ("EPSG:25832", None),
    "a code in feet": ("EPSG:2229", "is not known to be in metres; found EPSG:2229"),
    "something else": ("UTM 32", "is no reference system that can be read; found UTM 32; allowed: WKT"),
}


@pytest.mark.parametrize(("text", "said"), SYSTEMS.values(), ids=SYSTEMS.keys())
def test_a_projection_file_counts_where_the_geotiff_names_no_system(
    text: str, said: str | None, tmp_path: Path
) -> None:
    file = write_tiff(tmp_path / "a.tif", image(HEIGHTS))
    (tmp_path / "a.prj").write_text(text, encoding="utf-8")
    if said is None:
        np.testing.assert_array_equal(read_height_grid(file).heights, HEIGHTS)
    else:
        with pytest.raises(InputError, match=rf"a\.prj: the system of a\.tif: {said}"):
            read_height_grid(file)
    write_tiff(file, image(HEIGHTS, tags=placed({1024: 1, 3072: 25832})))
    np.testing.assert_array_equal(read_height_grid(file).heights, HEIGHTS)


def test_the_largest_number_of_16_bits_is_a_missing_height(tmp_path: Path) -> None:
    file = write_tiff(tmp_path / "a.tif", image(np.array([[1, 65535], [3, 4]]), kind="<u2"))
    np.testing.assert_array_equal(read_height_grid(file).heights, [[1, NAN], [3, 4]])
