"""Ways to corrupt what a text file says: keys, names, types, counts, encodings. A mixin of `damage.Damage`."""

import json
import random
from collections.abc import Callable
from pathlib import Path
from typing import Any

import bombs
import yaml

NAMES = (
    "",
    ".",
    "..",
    "../outside",
    "/etc/passwd",
    "a/../../../outside/x",
    "a" * 300,
    "a\0b",
    "\ud800",
    "über/ß",
    "a\nb",
    "CON",
    "-rf",
    "*",
    "[a-",
    "%00",
    "\u202egnp.exe",
    "~",
    "~root",
    " ",
    "a//b",
    "a\\..\\b",
    "1.5e3",
    "null",
)
"""Names that trouble file systems, shells, patterns or encodings."""
ENCODINGS = ("utf-16", "utf-8-sig", "latin-1", "utf-32-le", "cp500")
BAD: tuple[Any, ...] = (
    float("nan"),
    float("inf"),
    -float("inf"),
    -1,
    0,
    1e308,
    5e-324,
    10**30,
    2**63,
    "x",
    None,
    [],
    {},
    True,
    [[[]]],
    "\0",
    "a" * 5000,
    {"a": {"b": {}}},
    [None] * 3,
    "1e5",
    "0x10",
    -0.0,
)
Place = tuple[Any, ...]


def leaves(content: Any, place: Place = ()) -> list[Place]:
    """Places of all values that hold no others."""
    inner = content.items() if isinstance(content, dict) else enumerate(content) if isinstance(content, list) else ()
    found = [leaf for key, value in inner for leaf in leaves(value, (*place, key))]
    return found or ([place] if place else [])


def put(content: Any, place: Place, value: Any) -> None:
    """Replace what is at a place."""
    holder(content, place)[place[-1]] = value


def holder(content: Any, place: Place) -> Any:
    """What holds the value at a place."""
    for key in place[:-1]:
        content = content[key]
    return content


class Structure:
    """Corruptions of JSON and YAML that know its structure. Each returns whether an error must follow; None: does not apply."""

    random: random.Random
    outside: Path
    pick: Callable[..., Path | None]

    def _changed(self, change: Callable[[Any], None], *suffixes: str) -> Path | None:
        """Apply `change` to the content of one JSON or YAML file (of a .jsonl: one line), and write it back."""
        path = self.pick(*(suffixes or (".json", ".jsonl", ".yaml")))
        if path is None:
            return None
        text = path.read_text()
        if path.suffix == ".yaml":
            content = yaml.safe_load(text)
            change(content)
            path.write_text(yaml.safe_dump(content, allow_unicode=True, sort_keys=False), errors="surrogatepass")
        elif path.suffix == ".jsonl":
            lines = [json.loads(line) for line in text.splitlines()]
            change(self.random.choice(lines))
            path.write_text("".join(json.dumps(line) + "\n" for line in lines))
        else:
            content = json.loads(text)
            change(content)
            path.write_text(json.dumps(content))
        return path

    def bad_value(self) -> bool | None:
        """A leaf becomes something else."""
        return None if self._changed(lambda c: put(c, self.random.choice(leaves(c)), self.random.choice(BAD))) is None else False

    def nested_type(self) -> bool | None:
        """A value anywhere in the tree, branches included, becomes something else."""

        def change(content: Any) -> None:
            place = self.random.choice(leaves(content))
            put(content, place[: self.random.randint(1, len(place))], self.random.choice(BAD))

        return None if self._changed(change) is None else False

    def drop_key(self) -> bool | None:
        """A key or an item is missing."""

        def change(content: Any) -> None:
            place = self.random.choice(leaves(content))
            place = place[: self.random.randint(1, len(place))]
            del holder(content, place)[place[-1]]

        return None if self._changed(change) is None else False

    def odd_name(self) -> bool | None:
        """A text becomes a name that troubles file systems."""

        def change(content: Any) -> None:
            texts = [place for place in leaves(content) if isinstance(holder(content, place)[place[-1]], str)]
            if texts:
                put(content, self.random.choice(texts), self.random.choice(NAMES))

        return None if self._changed(change) is None else False

    def odd_key(self) -> bool | None:
        """A key gets a name that leads elsewhere, or that is no name; also those of truth channels."""

        def change(content: Any) -> None:
            place = self.random.choice([place for place in leaves(content) if any(isinstance(key, str) for key in place)])
            ends = [index for index, key in enumerate(place) if isinstance(key, str)]
            truths = [index for index in ends if index and place[index - 1] == "truth"]
            end = self.random.choice(truths or ends)
            holding = holder(content, place[: end + 1])
            steps = "../" * self.random.randint(1, 6)
            name = self.random.choice((*NAMES, f"{steps}{self.outside.name}/.ssh", str(self.outside / "key"), f"depth/{steps}x"))
            holding[name] = holding.pop(place[end])

        return None if self._changed(change) is None else False

    def truth_key(self) -> bool | None:
        """The channel of a truth map is a path that leaves the output folder. Writing such a scene must be refused."""
        found = False

        def change(content: Any) -> None:
            nonlocal found
            places = [place for place in leaves(content) if len(place) > 1 and place[-2] == "truth"]
            steps = "../" * self.random.randint(1, 6)
            for place in places[: self.random.randint(1, 4)]:
                channels = holder(content, place)
                name = self.random.choice((f"{steps}{self.outside.name}/.ssh", str(self.outside / "key"), f"{steps}victim"))
                channels[name] = channels.pop(place[-1])
                found = True

        return None if self._changed(change, ".json") is None or not found else True

    def duplicate_key(self) -> bool | None:
        """A key is given twice."""
        path = self.pick(".json", ".yaml")
        if path is None:
            return None
        lines = path.read_text().splitlines()
        numbers = [number for number, line in enumerate(lines) if ":" in line and (path.suffix == ".yaml" or line.endswith(","))]
        if not numbers:
            return None
        number = self.random.choice(numbers)
        path.write_text("\n".join([*lines[:number], lines[number], *lines[number:]]))
        return False

    def huge_count(self) -> bool | None:
        """A list repeats itself thousands of times, or a number is a count that nobody has memory for."""

        def change(content: Any) -> None:
            place = self.random.choice(leaves(content))
            for end in range(1, len(place)):
                value = holder(content, place[: end + 1])
                if isinstance(value, list) and value and self.random.random() < 0.5:
                    value *= self.random.choice((100, 3000))
                    return
            put(content, place, self.random.choice((10**6, 10**8, 10**9, 2**31 - 1, 2**62)))

        return None if self._changed(change) is None else False

    def encoding(self) -> bool | None:
        """A text in another encoding, or with other ends of lines."""
        path = self.pick(".json", ".jsonl", ".yaml", ".txt", ".csv", ".ply")
        if path is None or b"binary" in path.read_bytes()[:40]:
            return None
        text = path.read_text()
        way = self.random.randrange(len(ENCODINGS) + 2)
        if way < len(ENCODINGS):
            path.write_bytes(("é" * (way % 2) + text).encode(ENCODINGS[way], "replace"))
        else:
            path.write_bytes(text.replace("\n", "\r\n" if way == len(ENCODINGS) else "\r").encode())
        return False

    def deep(self) -> bool | None:
        """Nested thousands of levels deep."""
        path = self.pick(".json", ".jsonl", ".yaml")
        if path is None:
            return None
        opening, closing = self.random.choice((("[", "]"), ('{"a":', "}")))
        depth = self.random.choice((60, 2000, 100_000) if path.suffix == ".yaml" else (2000, 100_000, 1_000_000))
        closed = self.random.random() < 0.5
        path.write_text(opening * depth + ("1" + closing * depth if closed else "") + "\n")
        return "checkpoints" not in path.parts  # the checkpoint before a damaged one is used

    def digits(self) -> bool | None:
        """A number of ten thousand digits."""
        path = self.pick(".json")
        if path is None:
            return None
        path.write_text('{"format": "koala-scene", "version": ' + "9" * 10_000 + "}")
        return "checkpoints" not in path.parts

    def alias_bomb(self) -> bool | None:
        """YAML whose aliases stand for billions of values, for themselves, or for Python objects."""
        path = self.pick(".yaml")
        if path is None:
            return None
        keys = list(yaml.safe_load(path.read_text()))
        key = self.random.choice(keys)
        kept = "\n".join(line for line in path.read_text().splitlines() if not line.startswith((f"{key}:", " ", "-")))
        trap = f"!!python/object/apply:os.mkdir ['{self.outside / 'sprung'}']"
        text = self.random.choice(
            (
                bombs.aliases(self.random.choice((6, 9, 20)), self.random.choice((2, 9)), key),
                f"{key}: &a [*a]\n",
                f"{key}: &a {{b: *a}}\n",
                f"{key}: {trap}\n",
                f"<<: &a {{{key}: 1}}\n{key}: *a\n",
                f"{key}: {'[' * 40}{']' * 40}\n",
                f"? [a, b]\n: 1\n{key}: 2\n",
                f"{key}: !!binary {'A' * 400000}\n",
                f"{key}: {'9' * 5000}\n",
                f"{key}: 2001-99-99\n",
                f"{key}: 190:20:30:15\n",
            )
        )
        path.write_text(f"{kept}\n{text}" if self.random.random() < 0.7 else text)
        return False
