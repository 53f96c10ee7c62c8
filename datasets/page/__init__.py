"""What the pages of all four commands share: a server for this machine alone, shapes, and a picture panel.

Built on viser: `open_page` starts it and sees to it that it stays on this machine; the `view` modules of the packages draw with its scene
and its panel.
"""

from datasets.page.panel import PicturePanel
from datasets.page.server import PORT, Page, open_page

__all__ = ["PORT", "Page", "PicturePanel", "open_page"]
