"""Atomic and durable writing, and reading that stays inside a folder.

Every file is written to a temporary name in its own folder, flushed to the disk and renamed; then the folder is flushed. Readers
never see half a file, even after a full disk, a killed process or a power cut.
"""

import codecs
import errno
import hashlib
import json
import os
import shutil
import stat
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from koala3d.datasets.core.errors import DatasetError, UsageError, nearest

MAX_JSON_BYTES = 2**26  # larger JSON files are refused; one of ten thousand frames has a fifth of this size
LONGEST_NAME = 255  # longest file name that file systems allow [bytes]
MOST_LISTED = 12  # largest number of names that advice lists


@contextmanager
def atomic_path(path: Path) -> Iterator[Path]:
    """Yield a temporary path beside `path` (same suffix); on success flush it and rename it to `path`.

    On any exception, Ctrl-C and a full disk included, the temporary file is removed and `path` is untouched.
    """
    path = Path(path)
    make_folder(path.parent)
    handle, name = tempfile.mkstemp(prefix=f".{path.stem}.", suffix=path.suffix, dir=path.parent)
    os.close(handle)
    temporary = Path(name)
    try:
        yield temporary
        os.chmod(temporary, 0o644)
        flush(temporary)
        os.replace(temporary, path)
        flush(path.parent)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise


@contextmanager
def atomic_folder(path: Path) -> Iterator[Path]:
    """Yield an empty temporary folder beside `path`; on success flush everything in it and rename it to `path`, else remove it.

    Raises UsageError: `path` exists and is not an empty folder: nothing is ever overwritten.
    """
    path = Path(path)
    refuse_existing(path)
    make_folder(path.parent)
    temporary = Path(tempfile.mkdtemp(prefix=f".{path.name}.", dir=path.parent))
    try:
        yield temporary
        os.chmod(temporary, 0o755)
        for folder, _, names in os.walk(temporary, topdown=False):
            for found in (*(Path(folder, name) for name in names), Path(folder)):
                if not found.is_symlink():
                    flush(found)
        if path.exists():
            path.rmdir()
        os.replace(temporary, path)
        flush(path.parent)
    except BaseException:
        shutil.rmtree(temporary, ignore_errors=True)
        raise


def flush(path: Path) -> None:
    """Return once the content of a file, or the names in a folder, are on the disk."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    except OSError as error:
        if error.errno != errno.EINVAL:  # some network file systems cannot flush folders
            raise
    finally:
        os.close(handle)


def cache_folder() -> Path:
    """Folder for reproducible files: KOALA_CACHE, or below the user's cache folder."""
    default = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "koala"
    return Path(os.environ.get("KOALA_CACHE") or default)


def make_folder(path: Path) -> None:
    """Make a folder and its parents where they are missing; their names are on the disk when this returns."""
    path = Path(path)
    new = [folder for folder in (path, *path.parents) if not folder.exists()]
    path.mkdir(parents=True, exist_ok=True)
    for folder in reversed(new):
        flush(folder.parent)


def required_suffix(path: Path, what: str, suffixes: Iterable[str]) -> str:
    """The suffix of a file to write, in lower case. Raises UsageError if it is none of those in which `what` is written."""
    found = path.suffix.lower()
    if found not in (known := list(suffixes)):
        raise UsageError(f"{what} are not written as '{path.suffix}'", where=path, remedy=f"end --out in {', '.join(known)}")
    return found


def refuse_existing(path: Path) -> None:
    """Raise UsageError where `path` holds something already: results are never overwritten."""
    path = Path(path)
    if path.is_file() or (path.is_dir() and any(path.iterdir())):
        raise UsageError("already exists", where=path, remedy="choose another name, or remove it first")


def write_bytes(path: Path, data: bytes) -> None:
    """Write `data` atomically."""
    with atomic_path(path) as temporary:
        temporary.write_bytes(data)


def write_text(path: Path, text: str) -> None:
    """Write `text` as UTF-8, atomically."""
    write_bytes(path, text.encode())


def write_json(path: Path, content: Any) -> None:
    """Write `content` as indented JSON, atomically. NaN and infinity are refused, as JSON has neither."""
    write_text(path, json.dumps(content, indent=1, allow_nan=False, default=plain) + "\n")


def plain(value: Any) -> Any:
    """What JSON holds in place of an array, a number of NumPy or a path. Raises TypeError for other values."""
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, Path):
        return str(value)
    raise TypeError(f"{type(value).__name__} has no JSON form")


def read_json(path: Path, *, kind: str | None = None, version: int | None = None) -> Any:
    """Read a JSON file; with `kind`, check that its "format" and "version" are what this version reads.

    Raises:
        UsageError: the file is missing.
        DatasetError: it is no JSON, of another kind, or written by a newer version.
    """
    path = Path(path)
    try:
        content = json.loads(read_text(path, MAX_JSON_BYTES, suffixes=(".json",)))
    except (ValueError, RecursionError) as error:
        raise DatasetError("is not valid JSON", where=path, why=str(error), remedy="write it again") from None
    if kind is not None:
        found = content.get("format") if isinstance(content, dict) else None
        if found != kind:
            raise DatasetError(f"is not a {kind} file", where=path, why=f"its format says {found!r}")
        if version is not None and content.get("version") != version:
            what, why = f"{kind} version {content.get('version')} cannot be read", f"this Koala reads version {version}"
            raise DatasetError(what, where=path, why=why, remedy="use the Koala version that wrote it")
    return content


def read_text(path: Path, limit: int, *, suffixes: tuple[str, ...] = ()) -> str:
    """The text of a regular file in UTF-8, or in UTF-16 if it begins as such; without the byte order mark that Excel writes.

    Raises what `read_regular` raises, and DatasetError if the file is not text.
    """
    data = read_regular(path, limit, suffixes=suffixes)
    try:
        return data.decode("utf-16" if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)) else "utf-8-sig")
    except UnicodeDecodeError as error:
        raise DatasetError("is not a text file", where=path, why=str(error), remedy="save it as text in UTF-8") from None


def parse_xml(text: str, *, where: object) -> ElementTree.Element:
    """The root of an XML document. Raises DatasetError if it is damaged, or declares entities: these could grow without bound."""
    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        raise DatasetError("XML is not plain", where=where, why="it declares entities", remedy="write it without a DOCTYPE")
    try:
        return ElementTree.fromstring(text.encode())
    except (ElementTree.ParseError, ValueError) as error:
        raise DatasetError("is not valid XML", where=where, why=str(error), remedy="write it again") from None


def read_regular(path: Path, limit: int, *, suffixes: tuple[str, ...] = ()) -> bytes:
    """The bytes of a regular file. Pipes, devices and files of more than `limit` bytes are refused before anything is read.

    Raises:
        UsageError: it is missing (the advice names neighbours with one of the `suffixes`), no regular file, or too large.
        DatasetError: it cannot be read.
    """
    path = Path(path)
    try:
        handle = os.open(path, os.O_RDONLY | os.O_NONBLOCK)  # opening a pipe would wait for its writer
        try:
            if not stat.S_ISREG(os.fstat(handle).st_mode):
                raise UsageError("is not a file", where=path, why="it is a folder, a pipe or a device", remedy="check the path")
            data = bytearray()
            while len(data) <= limit and (block := os.read(handle, min(limit + 1 - len(data), 2**24))):
                data += block
        finally:
            os.close(handle)
    except FileNotFoundError:
        raise UsageError("no such file", where=path, remedy=neighbour(path, *suffixes)) from None
    except NotADirectoryError:
        raise UsageError("is not a file", where=path, remedy="check the path") from None
    except (OSError, ValueError) as error:  # ValueError: the name cannot be a file's
        why = getattr(error, "strerror", None) or str(error)
        raise DatasetError("cannot be read", where=path, why=why, remedy="copy it again") from None
    if len(data) > limit:
        raise UsageError("is too large", where=path, why=f"the limit for such a file is {limit} bytes", remedy="check the path")
    return bytes(data)


def neighbour(path: Path, *suffixes: str) -> str:
    """Advice for a missing file: the most similar name in its folder, or all names where they are few."""
    if not path.parent.is_dir():
        return f"there is no folder {path.parent}"
    names = [other.name for other in path.parent.iterdir() if other.suffix in suffixes]
    advice = nearest(path.name, names)
    return advice if names and (len(names) <= MOST_LISTED or advice.startswith("did you mean")) else "check the path"


def inside(folder: Path, name: str, *, where: object = "") -> Path:
    """Path below `folder` of `name` as a file states it. Links in the folder itself are followed: a person made them.

    Raises DatasetError: `name` is absolute, leaves `folder`, or cannot be the name of a file.
    """
    try:
        plain = os.path.normpath(name)  # resolves ".." by the words alone, so that it cannot lead out of a linked folder
        if "\0" in plain or any(len(os.fsencode(part)) > LONGEST_NAME for part in plain.split(os.sep)):
            raise ValueError("a name in it is too long or holds a zero byte")
    except (TypeError, ValueError) as error:
        raise DatasetError(f"path {str(name)[:80]!r} is not usable", where=where or folder, why=str(error)) from None
    if os.path.isabs(plain) or plain.split(os.sep)[0] == os.pardir:
        raise DatasetError(f"path {name!r} leaves the folder", where=where or folder, remedy="use paths relative to it")
    return Path(folder) / plain


def within(folder: Path, path: Path, *, where: object = "") -> Path:
    """`path`, which begins with `folder`. Raises DatasetError where it leaves the folder."""
    return inside(folder, os.path.relpath(path, folder), where=where)


def target(folder: Path, name: str) -> Path:
    """Path below `folder` to write to, its own folder made. Raises DatasetError where it leads out, also through a link."""
    path = inside(folder, name)
    if not path.resolve().is_relative_to(Path(folder).resolve()):
        raise DatasetError(f"path {name!r} leaves the folder", where=folder, why="through a link", remedy="remove the link")
    path.parent.mkdir(parents=True, exist_ok=True)
    return path


def sha256(path: Path) -> str:
    """Hexadecimal SHA-256 of a regular file. Raises UsageError for anything else: reading a pipe would wait for its writer."""
    if not Path(path).is_file():
        raise UsageError("is not a file", where=path, why="it is missing, a folder, a pipe or a device", remedy="check the path")
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
