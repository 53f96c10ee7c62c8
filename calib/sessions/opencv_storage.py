"""Files that OpenCV's FileStorage wrote, in YAML or XML, as plain values.

OpenCV's own parser is not used: these files come from strangers. Its YAML is ours but for the first line and the tag of a matrix.
"""

import re
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from koala3d.datasets.core import files, plain_yaml
from koala3d.datasets.core.errors import DatasetError

MAX_XML_BYTES = 2**22
_MATRIX = re.compile(r"(?<=[:\-\[,]) *!!opencv-matrix\b")


def read_yaml(path: Path) -> Any:
    """Content of a YAML file, whether OpenCV wrote it or not. A matrix is a mapping of rows, cols, dt and data."""
    text = plain_yaml.read_text(path)
    first, _, rest = text.partition("\n")
    return plain_yaml.parse(_MATRIX.sub("", rest if first.startswith("%YAML") else text), where=path)


def read_xml(path: Path) -> Any:
    """Content of an XML file of OpenCV, as `read_yaml` gives it. Raises DatasetError for other XML."""
    text = files.read_text(path, MAX_XML_BYTES, suffixes=(".xml",))
    try:
        if "<!DOCTYPE" in text or "<!ENTITY" in text:
            raise ElementTree.ParseError("it declares entities")
        root = ElementTree.fromstring(text)
        if root.tag != "opencv_storage":
            raise ElementTree.ParseError(f"it begins with <{root.tag}>, not with <opencv_storage>")
        return _value(root)
    except (ElementTree.ParseError, LookupError, RecursionError, ValueError) as error:
        raise DatasetError("is not an XML file of OpenCV", where=path, why=str(error)) from None


def rows(value: Any, *, where: object) -> Any:
    """The rows of a matrix, as `read_yaml` gives it; any other value as it is."""
    if not (isinstance(value, dict) and {"rows", "cols", "data"} <= set(value)):
        return value
    size, data = (value["rows"], value["cols"]), value["data"]
    is_matrix = isinstance(data, list) and all(isinstance(length, int) and length > 0 for length in size)
    if not (is_matrix and len(data) == size[0] * size[1]):
        raise DatasetError("matrix does not have the numbers that it states", where=where, why=f"{size[0]} x {size[1]}"[:80])
    return [data[start : start + size[1]] for start in range(0, len(data), size[1])]


def _value(element: ElementTree.Element) -> Any:
    """Mapping, list or numbers of an element."""
    children = list(element)
    if element.get("type_id") == "opencv-matrix":
        found = {child.tag: child.text or "" for child in children}
        return {"rows": int(found["rows"]), "cols": int(found["cols"]), "data": [float(word) for word in found["data"].split()]}
    if children and all(child.tag == "_" for child in children):
        return [_value(child) for child in children]
    if children:
        return {child.tag: _value(child) for child in children}
    words = (element.text or "").split()
    try:
        return [float(word) for word in words]
    except ValueError:
        return " ".join(words)
