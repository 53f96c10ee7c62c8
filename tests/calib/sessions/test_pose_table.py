"""Tables byte for byte as spreadsheets write them."""

import codecs

import numpy as np
import pytest

from koala3d.calib.sessions import pose_table
from koala3d.calib.sessions.description import Description
from koala3d.datasets.core.errors import KoalaError, UsageError

BOARD = {"type": "chessboard", "squares_x": 10, "squares_y": 7, "square_length_m": 0.02}
ROWS = {"b.png": [0.1, -0.25, 0.5, 1.5, 0.0, -0.02], "a.png": [0.3, 0.2, 0.5, 0.1, 0.00001, 2.0]}


def read(tmp_path, data, **said):
    plain = {"images": "*.png", "poses": "poses.csv", "layout": "x y z rx ry rz", "board": BOARD, **said}
    (tmp_path / "poses.csv").write_bytes(data)
    return pose_table.read(tmp_path / "poses.csv", Description(**plain))


ENGLISH = b"image,x,y,z,rx,ry,rz\r\nb.png,0.1,-0.25,0.5,1.5,0,-0.02\r\na.png,0.3,0.2,0.5,0.1,1E-05,2\r\n"
GERMAN = b"image;x;y;z;rx;ry;rz\r\nb.png;0,1;-0,25;0,5;1,5;0;-0,02\r\na.png;0,3;0,2;0,5;0,1;1E-05;2\r\n"
KINDS = {
    "plain": ENGLISH,
    "byte order mark": codecs.BOM_UTF8 + ENGLISH,
    "semicolons and decimal commas": GERMAN,
    "all of it": codecs.BOM_UTF8 + GERMAN + b";;;;;;\r\n",
    "Unicode text of Excel": codecs.BOM_UTF16_LE + ENGLISH.decode().replace(",", "\t").encode("utf-16-le"),
    "hint to Excel": b"sep=;\r\n" + GERMAN,
    "tabs and decimal commas": GERMAN.replace(b";", b"\t"),
    "quoted decimal commas": b'image,x,y,z,rx,ry,rz\nb.png,"0,1","-0,25","0,5","1,5",0,"-0,02"\n'
    b'a.png,"0,3","0,2","0,5","0,1",1E-05,2\n',
    "comments": b"# of 3 March\n" + ENGLISH + b"# the end\n",
    "separators at the end": ENGLISH.replace(b"\r\n", b",\r\n"),
    "capitals, other order": b"RX,RY,RZ,Image,X,Y,Z\n1.5,0,-0.02,b.png,0.1,-0.25,0.5\n0.1,1e-5,2,a.png,0.3,0.2,0.5\n",
    "units": ENGLISH.replace(b"x,y,z,rx,ry,rz", b"x_m,y (m),z [m],rx rad,ry_rad,rz[radians]", 1),
}


@pytest.mark.parametrize("data", KINDS.values(), ids=KINDS)
def test_every_way_of_writing_a_table_gives_the_same_numbers(tmp_path, data):
    found = {name: np.asarray(row, np.float64).tolist() for name, row in read(tmp_path, data).items()}
    assert found == ROWS and list(found) == list(ROWS)


def test_units_of_the_header_are_those_of_the_description(tmp_path):
    data = ENGLISH.replace(b"x,y,z,rx,ry,rz", b"x_mm,y_mm,z_mm,rx_deg,ry_deg,rz_deg", 1)
    assert len(read(tmp_path, data, length="mm", angle="deg")) == 2
    with pytest.raises(UsageError, match=r"'x_mm' has another unit.*length: m\).*say length: mm"):
        read(tmp_path, data)
    with pytest.raises(UsageError, match=r"'rx_deg' has another unit.*say angle: deg"):
        read(tmp_path, data, length="mm")
    with pytest.raises(UsageError, match=r"'x_m' has another unit.*say length: m in"):
        read(tmp_path, ENGLISH.replace(b"x,y", b"x_m,y", 1), length="mm")
    with pytest.raises(UsageError, match=r"possible are m and mm"):
        read(tmp_path, ENGLISH.replace(b"x,y", b"x_cm,y", 1))


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (ENGLISH.replace(b"image,", b"picture,", 1), "unknown column 'picture'.*image"),
        (ENGLISH.replace(b"image,x,", b"image,x,", 1).replace(b"ry,", b"r,", 1), "no column 'ry'"),
        (b"\xef\xbb\xbfb.png,0.1,-0.25,0.5,1.5,0,-0.02\n", "no column 'x'.*first line names the columns"),
        (ENGLISH.replace(b"a.png", b"b.png"), r"image is listed twice \(b.png\)"),
        (ENGLISH.replace(b"image,x", b"image,y", 1), "no column 'x'"),
        (b"image,x,y,z,rx,ry,rz,rz\nb.png,0,0,0,0,0,0,0\n", "two columns have one name"),
        (ENGLISH.replace(b"-0.25", b"-0,25"), r"line does not fit the header \(8 words.*quote numbers with a decimal comma"),
        (ENGLISH.replace(b"-0.25", b'"1,250.5"'), "numbers have commas and points"),
        (GERMAN.replace(b"-0,25", b"-0.25"), "numbers have commas and points"),
        (b"", "is empty"),
    ],
)
def test_other_tables_are_refused_by_name(tmp_path, data, words):
    with pytest.raises(KoalaError, match=words) as refused:
        read(tmp_path, data)
    assert "poses.csv" in str(refused.value)


def test_a_matrix_may_lack_its_last_row(tmp_path):
    names = [f"m{row}{column}" for row in range(4) for column in range(4)]
    upper = ",".join(names[:12]).encode() + b"\n" + b",".join([b"1"] * 12) + b"\n"
    assert [len(row) for row in read(tmp_path, upper, layout="matrix")] == [12]
    whole = ",".join(names).encode() + b"\n" + b",".join([b"1"] * 16) + b"\n"
    assert [len(row) for row in read(tmp_path, whole, layout="matrix")] == [16]
    millimetres = whole.replace(b"m03,", b"m03_mm,")
    assert len(read(tmp_path, millimetres, layout="matrix", length="mm")) == 1
    with pytest.raises(UsageError, match=r"'m03_mm' has another unit.*say length: mm"):
        read(tmp_path, millimetres, layout="matrix")
    with pytest.raises(KoalaError, match="no column 'm33'"):
        read(tmp_path, ",".join(names[:15]).encode() + b"\n" + b",".join([b"1"] * 15) + b"\n", layout="matrix")
