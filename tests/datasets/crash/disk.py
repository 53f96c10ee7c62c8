"""A model of a disk: what of a folder is there at once, and what survives a power cut.

A file's data survives once it is flushed (fsync, fdatasync). A name in a folder, its removal or its change survives once
that folder is flushed. POSIX promises no more, and file systems differ in what they give beyond it.
"""

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from strace import Call, data_of, descriptor_of, path_of

Tree = dict[str, bytes | None]
"""Content of every file by its path in the folder; None for folders."""
VARIANTS = ("dropped", "names", "zeros", "killed")
"""What a crash leaves: nothing unflushed; all names, but no unflushed data; the same at full length in zeros; everything
(a kill without a power cut). Beside these, "without FOLDER": everything but the unflushed names of one folder."""
IGNORED = ("ioctl", "fcntl", "fallocate")


@dataclass(eq=False)
class Node:
    """A file or a folder."""

    is_folder: bool = False
    live: bytearray = field(default_factory=bytearray)
    durable: bytes = b""
    names: dict[str, "Node"] = field(default_factory=dict)
    durable_names: dict[str, "Node"] = field(default_factory=dict)

    def flush(self) -> None:
        """What fsync does."""
        self.durable, self.durable_names = bytes(self.live), dict(self.names)


@dataclass(eq=False)
class Opened:
    """An open file."""

    node: Node
    path: Path
    place: int = 0
    append: bool = False


class Disk:
    """Replays calls on one folder, which is empty at first. `marks` are the names of what a program reported as done."""

    def __init__(self, root: Path, marks: Path) -> None:
        self.root, self.root_of_marks = root, marks
        self.top = Node(True)
        self.opened: dict[int, Opened] = {}
        self.marks: list[str] = []

    def apply(self, call: Call) -> bool:
        """Replay one call; whether it changed anything, on the disk or in what was reported."""
        if call.name == "mkdir" and (path := path_of(call.arguments[0])) is not None and path.parent == self.root_of_marks:
            self.marks.append(path.name)
            return True
        if call.name in IGNORED:
            return False
        return bool(getattr(self, f"_{call.name}", self._nothing)(call))

    def _nothing(self, call: Call) -> bool:
        raise NotImplementedError(f"strace shows {call.name}, which the model does not know")

    # -- paths

    def _inside(self, path: Path | None) -> tuple[str, ...] | None:
        return path.relative_to(self.root).parts if path is not None and path.is_relative_to(self.root) else None

    def _node(self, path: Path | None) -> Node | None:
        parts = self._inside(path)
        node: Node | None = self.top if parts is not None else None
        for part in parts or ():
            node = node.names.get(part) if node is not None else None
        return node

    def _parent(self, path: Path | None) -> tuple[Node, str] | None:
        parts = self._inside(path)
        if not parts or path is None:
            return None
        parent = self._node(path.parent)
        assert parent is not None, f"{path} appears in a folder that nobody made"
        return parent, parts[-1]

    @staticmethod
    def _at(call: Call, first: int, at: bool) -> Path | None:
        """Path of arguments: a name, or with `at` a folder's descriptor and a name."""
        name = path_of(call.arguments[first + at])
        if not at or name is None or name.is_absolute():
            return name
        folder = path_of(call.arguments[first])
        return None if folder is None else folder / name

    # -- files

    def _openat(self, call: Call) -> bool:
        path = self._at(call, 0, call.name == "openat")
        flags = call.arguments[1 + (call.name == "openat")] if call.name != "creat" else "O_CREAT|O_TRUNC"
        assert "O_TMPFILE" not in flags or self._inside(path) is None, "files without a name are not modelled"
        place = self._parent(path)
        if place is None and self._node(path) is None:
            self.opened.pop(call.result, None) if self._inside(path) is not None else None
            return False
        node, changed = self._node(path), False
        if node is None and place is not None:
            node = place[0].names[place[1]] = Node()
            changed = True
        assert node is not None
        if "O_TRUNC" in flags and node.live:
            node.live, changed = bytearray(), True
        self.opened[call.result] = Opened(node, path, append="O_APPEND" in flags)
        return changed

    _open = _creat = _openat

    def _close(self, call: Call) -> bool:
        """Forget a descriptor, unless another thread got it for another file before strace logged that it was closed."""
        opened = self.opened.get(descriptor_of(call.arguments[0]))
        if opened is not None and opened.path == path_of(call.arguments[0]):
            del self.opened[descriptor_of(call.arguments[0])]
        return False

    def _dup(self, call: Call) -> bool:
        if self._inside(path_of(call.arguments[0])) is not None:
            self.opened[call.result] = self.opened[descriptor_of(call.arguments[0])]
        return False

    _dup2 = _dup3 = _dup

    def _file(self, argument: str) -> Opened | None:
        return None if self._inside(path_of(argument)) is None else self.opened[descriptor_of(argument)]

    def _put(self, opened: Opened, data: bytes, place: int | None = None) -> bool:
        node = opened.node
        at = len(node.live) if opened.append else opened.place if place is None else place
        node.live.extend(bytes(max(at - len(node.live), 0)))
        node.live[at : at + len(data)] = data
        if place is None:
            opened.place = at + len(data)
        return bool(data)

    def _write(self, call: Call) -> bool:
        opened = self._file(call.arguments[0])
        if opened is None:
            return False
        place = int(call.arguments[-1]) if call.name == "pwrite64" else int(call.arguments[3]) if "pwritev" in call.name else None
        return self._put(opened, data_of(call.arguments[1])[: call.result], place)

    _pwrite64 = _writev = _pwritev = _pwritev2 = _write

    def _sendfile(self, call: Call) -> bool:
        opened = self._file(call.arguments[0])
        if opened is None:
            return False
        source, start = path_of(call.arguments[1]), call.arguments[2]
        assert source is not None and start.startswith("["), "a copy from where its source stands is not modelled"
        node, at = self._node(source), int(start[1:].partition("]")[0])
        data = bytes(node.live) if node is not None else source.read_bytes()
        return self._put(opened, data[at : at + call.result])

    def _copy_file_range(self, call: Call) -> bool:
        opened = self._file(call.arguments[2])
        if opened is None:
            return False
        source = path_of(call.arguments[0])
        assert source is not None
        node = self._node(source)
        data = bytes(node.live) if node is not None else source.read_bytes()
        return self._put(opened, data[opened.place : opened.place + call.result])

    def _ftruncate(self, call: Call) -> bool:
        opened = self._file(call.arguments[0])
        return opened is not None and self._resize(opened.node, int(call.arguments[1]))

    def _truncate(self, call: Call) -> bool:
        node = self._node(path_of(call.arguments[0]))
        return node is not None and self._resize(node, int(call.arguments[1]))

    @staticmethod
    def _resize(node: Node, size: int) -> bool:
        changed = len(node.live) != size
        node.live = node.live[:size] + bytearray(max(size - len(node.live), 0))
        return changed

    def _lseek(self, call: Call) -> bool:
        opened = self._file(call.arguments[0])
        if opened is not None:
            opened.place = call.result
        return False

    def _mmap(self, call: Call) -> bool:
        shared = "MAP_SHARED" in call.arguments[3] and "PROT_WRITE" in call.arguments[2]
        assert not shared or self._inside(path_of(call.arguments[4])) is None, "writing through memory is not modelled"
        return False

    def _fsync(self, call: Call) -> bool:
        node = self._node(path_of(call.arguments[0]))
        if node is not None:
            node.flush()
        return node is not None

    _fdatasync = _fsync

    def _sync(self, call: Call) -> bool:
        waiting = [self.top]
        while waiting:
            node = waiting.pop()
            node.flush()
            waiting += node.names.values()
        return True

    _syncfs = _sync

    # -- names

    def _mkdir(self, call: Call) -> bool:
        place = self._parent(self._at(call, 0, call.name == "mkdirat"))
        if place is None:
            return False
        place[0].names[place[1]] = Node(True)
        return True

    _mkdirat = _mkdir

    def _unlink(self, call: Call) -> bool:
        place = self._parent(self._at(call, 0, call.name == "unlinkat"))
        return place is not None and place[0].names.pop(place[1], None) is not None

    _unlinkat = _rmdir = _unlink

    def _rename(self, call: Call) -> bool:
        at = call.name != "rename"
        source, target = self._at(call, 0, at), self._at(call, 1 + at, at)
        old, new = self._parent(source), self._parent(target)
        if old is None and new is None:
            return False
        assert old is not None and new is not None, f"{source} is renamed across the edge of the folder"
        new[0].names[new[1]] = old[0].names.pop(old[1])
        return True

    _renameat = _renameat2 = _rename

    def _link(self, call: Call) -> bool:
        at = call.name == "linkat"
        source, place = self._at(call, 0, at), self._parent(self._at(call, 1 + at, at))
        if place is None:
            return False
        node = self._node(source)
        if node is None:  # from outside, where it is durable since long
            assert source is not None
            node = Node(live=bytearray(source.read_bytes()))
            node.flush()
        place[0].names[place[1]] = node
        return True

    _linkat = _link

    # -- what a crash leaves

    def left(self, variant: str) -> Tree:
        """Everything in the folder after a crash now."""
        tree: Tree = {}
        self._collect(self.top, "", variant, tree)
        return tree

    def pending(self) -> list[str]:
        """Folders with names that are not flushed."""
        found, waiting = [], [("", self.top)]
        while waiting:
            path, node = waiting.pop()
            if node.names != node.durable_names:
                found.append(path)
            waiting += [(f"{path}/{name}" if path else name, inner) for name, inner in node.names.items() if inner.is_folder]
        return sorted(found)

    def _collect(self, node: Node, path: str, variant: str, tree: Tree) -> None:
        if not node.is_folder:
            content = {
                "dropped": node.durable,
                "names": node.durable,
                "zeros": node.durable[: len(node.live)].ljust(len(node.live), b"\0"),
            }
            tree[path] = content.get(variant, bytes(node.live))
            return
        if path:
            tree[path] = None
        names = node.durable_names if variant in ("dropped", f"without {path}") else node.names
        for name, inner in sorted(names.items()):
            self._collect(inner, f"{path}/{name}" if path else name, variant, tree)


def digest(tree: Tree) -> str:
    """Equal for equal trees."""
    parts = hashlib.sha256()
    for path, content in sorted(tree.items()):
        parts.update(f"{path}\0{-1 if content is None else len(content)}\0".encode(errors="surrogateescape") + (content or b""))
    return parts.hexdigest()


def restore(tree: Tree, root: Path) -> None:
    """Write a tree into an empty folder."""
    for path, content in sorted(tree.items()):
        target = root / path
        if content is None:
            target.mkdir(exist_ok=True)
        else:
            target.write_bytes(content)


@dataclass(frozen=True)
class State:
    """What a crash left after a number of changes."""

    prefix: int
    variant: str
    tree: Tree
    marks: tuple[str, ...]
    """What had been reported as done."""


def states(calls: list[Call], root: Path, marks: Path) -> Iterator[State]:
    """The state after every prefix of the calls, in every variant."""
    disk = Disk(root, marks)
    prefix = 0
    for call in calls:
        if disk.apply(call):
            prefix += 1
            for variant in (*(f"without {folder}" for folder in disk.pending()), *VARIANTS):
                yield State(prefix, variant, disk.left(variant), tuple(disk.marks))
