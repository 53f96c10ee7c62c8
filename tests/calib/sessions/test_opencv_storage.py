"""Files that OpenCV itself wrote."""

import cv2
import numpy as np
import pytest

from koala3d.calib.sessions import opencv_storage
from koala3d.datasets.core.errors import KoalaError

MATRIX = np.array([[0.1, -1e-9, 3, 400.25], [1e20, 0, -0.0, 2], [5, 6, 7, 8], [0, 0, 0, 1]])


@pytest.fixture(params=["yaml", "yml", "xml"])
def written(request, tmp_path):
    """What is read of a file with two matrices, a number, a word and a list."""
    path = tmp_path / f"poses.{request.param}"
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    storage.write("PoseState", MATRIX)
    storage.write("many", MATRIX.astype(np.float32).reshape(1, 16))
    storage.write("count", 3)
    storage.write("by", "a camera")
    storage.startWriteStruct("poses", cv2.FileNode_SEQ)
    storage.write("", MATRIX)
    storage.write("", MATRIX)
    storage.endWriteStruct()
    storage.release()
    return (opencv_storage.read_xml if request.param == "xml" else opencv_storage.read_yaml)(path)


def numbers(value):
    return np.asarray(opencv_storage.rows(value, where="here"), np.float64)


def test_matrices_of_opencv_are_read(written):
    np.testing.assert_array_equal(numbers(written["PoseState"]), MATRIX)
    np.testing.assert_allclose(numbers(written["many"]), MATRIX.reshape(1, 16), rtol=1e-7)
    np.testing.assert_array_equal([numbers(one) for one in written["poses"]], [MATRIX, MATRIX])
    assert written["by"].strip('"') == "a camera"


def test_the_first_line_may_have_been_removed(tmp_path):
    storage = cv2.FileStorage(str(tmp_path / "a.yaml"), cv2.FILE_STORAGE_WRITE)
    storage.write("PoseState", MATRIX)
    storage.release()
    text = (tmp_path / "a.yaml").read_text()
    assert text.startswith("%YAML:1.0")
    (tmp_path / "a.yaml").write_text(text.removeprefix("%YAML:1.0\n"))
    np.testing.assert_array_equal(numbers(opencv_storage.read_yaml(tmp_path / "a.yaml")["PoseState"]), MATRIX)


@pytest.mark.parametrize(
    "text",
    [
        "<opencv_storage><a>1",
        "<other/>",
        "<!DOCTYPE a [<!ENTITY b 'c'>]><opencv_storage><a>&b;</a></opencv_storage>",
        "<opencv_storage><a type_id='opencv-matrix'><rows>1</rows></a></opencv_storage>",
        "<opencv_storage><a type_id='opencv-matrix'><rows>1</rows><cols>x</cols><data>1</data></a></opencv_storage>",
        "<opencv_storage>" + "<a>" * 20000 + "</a>" * 20000 + "</opencv_storage>",
    ],
    ids=["cut off", "other XML", "entities", "no data", "no number", "deep"],
)
def test_other_xml_is_refused(tmp_path, text):
    (tmp_path / "a.xml").write_text(text)
    with pytest.raises(KoalaError, match="is not an XML file of OpenCV"):
        opencv_storage.read_xml(tmp_path / "a.xml")


@pytest.mark.parametrize("rows", [3, 0, -2, "2", None, 2.0])
def test_a_matrix_has_the_numbers_that_it_states(rows):
    with pytest.raises(KoalaError, match="does not have the numbers"):
        opencv_storage.rows({"rows": rows, "cols": 2, "data": [1, 2, 3, 4]}, where="here")
