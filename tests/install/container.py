"""Carry out the steps of Containerfile in a chroot, without a container engine: `python tests/install/container.py FOLDER`.

FOLDER holds a plain Debian of the release that the file names (`mmdebstrap --variant=minbase trixie FOLDER`), which is changed.
Needs root, and that /proc can be mounted. What an engine adds to that, layers and isolation, is not tried. Settings of this
machine's package registries (`PASSED_ON`, certificates) are passed on. Standard library only.
"""

import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]
STEPS = {"FROM", "ENV", "RUN", "WORKDIR", "COPY", "CMD"}
"""What is understood; anything else in the file is an error."""

PASSED_ON = ("PIP_", "NODE_", "SSL_")
"""How the names begin of environment variables that hold for the steps too."""


def steps(text: str) -> list[tuple[str, str]]:
    """(instruction, arguments) of a Containerfile. Raises ValueError for instructions that are not in `STEPS`."""
    lines = re.sub(r"\\\n", " ", text).splitlines()
    found = [(line.split()[0], line.split(maxsplit=1)[1]) for line in lines if line.strip() and not line.startswith("#")]
    if unknown := {name for name, _ in found} - STEPS:
        raise ValueError(f"not understood: {', '.join(sorted(unknown))}")
    return found


def ignored(root: Path) -> list[str]:
    """Patterns of names that are not copied."""
    return [line.removeprefix("**/") for line in (root / ".containerignore").read_text().split()]


class Chroot:
    """A folder with a Debian, and where in it the next step runs."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.inside = folder, "/"
        self.environment = {"PATH": "/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin", "HOME": "/root"}
        self.environment |= {name: value for name, value in os.environ.items() if name.startswith(PASSED_ON)}

    def carry_out(self, name: str, words: str) -> None:
        """One step. Raises CalledProcessError where a command fails."""
        print(f"{name} {words}", flush=True)
        if name == "RUN":
            script = f"cd {shlex.quote(self.inside)} && {words}"
            subprocess.run(["chroot", self.folder, "/bin/sh", "-ec", script], env=self.environment, check=True)
        elif name == "ENV":
            key, _, value = words.partition("=")
            self.environment[key] = value
        elif name == "WORKDIR":
            self.inside = words
            self.within(words).mkdir(parents=True, exist_ok=True)
        elif name == "COPY":
            source, target = words.split()
            omit = shutil.ignore_patterns(*ignored(ROOT))
            shutil.copytree(ROOT / source, self.within(self.inside) / target, ignore=omit, dirs_exist_ok=True)

    def within(self, path: str) -> Path:
        """A path of the chroot as seen from outside."""
        return self.folder / path.lstrip("/")


def main(folder: Path) -> None:
    """Carry out all steps, then start a command of the result."""
    chroot = Chroot(folder)
    for path in ("/etc/resolv.conf", "/etc/hosts", "/etc/ssl/certs/ca-certificates.crt"):
        if Path(path).is_file():
            chroot.within(path).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(path, chroot.within(path))
    subprocess.run(["mount", "-t", "proc", "proc", chroot.within("/proc")], check=True)
    try:
        for name, words in steps((ROOT / "Containerfile").read_text()):
            chroot.carry_out(name, words)
        chroot.carry_out("RUN", "reconstruct --help > /dev/null && capture --help > /dev/null")
    finally:
        subprocess.run(["umount", chroot.within("/proc")], check=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
