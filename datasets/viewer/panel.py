"""A picture with words in the side panel, for each browser its own: two people look at different views."""

import threading

import numpy as np
import viser
from numpy.typing import NDArray

from datasets import images
from datasets.viewer.server import Page

WIDTH = 640
"""Pictures are sent at this width at most [px]."""


class PicturePanel:
    """A folder of the panel that shows one picture and a text in each browser; empty until something is chosen."""

    def __init__(self, page: Page, title: str, hint: str) -> None:
        self._folder = page.gui.add_folder(title)
        with self._folder:
            self._hint = page.gui.add_markdown(f"*{hint}*")
        self._gui = page.gui
        self._shown: dict[int, tuple[viser.GuiMarkdownHandle, viser.GuiImageHandle]] = {}
        self._lock = threading.Lock()
        page.server.on_client_disconnect(lambda client: self._forget(client.client_id))

    def show(self, client: viser.ClientHandle, words: str, picture: NDArray[np.floating] | NDArray[np.uint8]) -> None:
        """Show (height, width, 1, 3 or 4) sRGB in 0..1 (or bytes) and Markdown in one browser, instead of what was there."""
        pixels = bytes_of(picture, WIDTH)
        with self._lock:
            shown = self._shown.get(client.client_id)
            if shown is None:
                with self._folder:
                    self._shown[client.client_id] = (
                        client.gui.add_markdown(words), client.gui.add_image(pixels, format="jpeg", jpeg_quality=90),
                    )  # fmt: skip
                return
            shown[0].content, shown[1].image = words, pixels

    def _forget(self, client_id: int) -> None:
        with self._lock:
            self._shown.pop(client_id, None)


def bytes_of(picture: NDArray[np.floating] | NDArray[np.uint8], width: int) -> NDArray[np.uint8]:
    """(h, w, 3) of a picture for the browser, at most `width` wide: alpha over white, grey as three channels.

    Args:
        picture: (height, width, 1 to 4) sRGB in 0..1, or bytes.
        width: greatest width of the result [px].
    """
    values = np.asarray(picture, np.float32) / 255 if picture.dtype == np.uint8 else np.clip(picture, 0, 1)
    if values.shape[1] > width:
        values = images.resize(values, width, max(1, round(values.shape[0] * width / values.shape[1])))
    if values.shape[-1] in (2, 4):
        values = values[..., :-1] * values[..., -1:] + 1 - values[..., -1:]
    if values.shape[-1] == 1:
        values = np.repeat(values, 3, axis=-1)
    return images.to_uint8(np.nan_to_num(values))
