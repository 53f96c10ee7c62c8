"""A picture with text in the side panel, separate for each browser: two people can look at different views."""

import threading

import numpy as np
import viser
from numpy.typing import NDArray

from koala3d.datasets.imaging import images
from koala3d.datasets.page.server import Page

Picture = NDArray[np.floating] | NDArray[np.uint8]

WIDTH = 640  # largest width of pictures that are sent [px]


class PicturePanel:
    """A folder of the panel with one picture and a text per browser; empty until something is selected."""

    def __init__(self, page: Page, title: str, hint: str) -> None:
        self._folder = page.gui.add_folder(title)
        with self._folder:
            self._hint = page.gui.add_markdown(f"*{hint}*")
        self._gui = page.gui
        self._shown: dict[int, list[viser.GuiMarkdownHandle | viser.GuiImageHandle]] = {}
        self._lock = threading.Lock()
        page.server.on_client_disconnect(lambda client: self._forget(client.client_id))

    def show(self, client: viser.ClientHandle, words: str, picture: Picture | None) -> None:
        """Replace what one browser shows by Markdown and a picture.

        Args:
            picture: (height, width, 1 to 4) sRGB in 0..1, or bytes; None for text only.
        """
        pixels = None if picture is None else bytes_of(picture, WIDTH)
        with self._lock:
            for handle in self._shown.pop(client.client_id, []):
                handle.remove()
            with self._folder:
                shown: list[viser.GuiMarkdownHandle | viser.GuiImageHandle] = [client.gui.add_markdown(words)]
                if pixels is not None:
                    shown.append(client.gui.add_image(pixels, format="jpeg", jpeg_quality=90))
            self._shown[client.client_id] = shown

    def _forget(self, client_id: int) -> None:
        with self._lock:
            self._shown.pop(client_id, None)


def bytes_of(picture: Picture, width: int) -> NDArray[np.uint8]:
    """(h, w, 3) of a picture for the browser, at most `width` wide: alpha over white, grey as three channels.

    Args:
        picture: (height, width, 1 to 4) sRGB in 0..1, or bytes.
    """
    values = np.asarray(picture, np.float32) / 255 if picture.dtype == np.uint8 else np.clip(picture, 0, 1)
    if values.shape[1] > width:
        values = images.resize(values, width, max(1, round(values.shape[0] * width / values.shape[1])))
    if values.shape[-1] in (2, 4):
        values = values[..., :-1] * values[..., -1:] + 1 - values[..., -1:]
    if values.shape[-1] == 1:
        values = np.repeat(values, 3, axis=-1)
    return images.to_uint8(np.where(np.isnan(values), 0, values))  # NaN, such as the depth of empty pixels, becomes black
