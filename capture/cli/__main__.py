"""`python -m koala3d.capture.cli` is the command `capture`."""

from koala3d.capture.cli import main

main()
