"""Shared by the pages of all four commands: a local server, shapes, and a panel for pictures.

Built on viser. `open_page` starts the server for this machine only; the `view` modules of the packages draw with its scene and
panel. Only pages import this package, so that everything else works without viser.
"""

from koala3d.datasets.page.panel import PicturePanel
from koala3d.datasets.page.server import PORT, Page, open_page

__all__ = ["PORT", "Page", "PicturePanel", "open_page"]
