"""What the pages of all four commands share: a server for this machine alone, shapes, and a picture panel.

The only place that knows viser; a page itself is made in the `view` module of each package.
"""

from datasets.viewer.panel import PicturePanel
from datasets.viewer.server import PORT, Page, open_page

__all__ = ["PORT", "Page", "PicturePanel", "open_page"]
