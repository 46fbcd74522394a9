"""A window that shows frames as they arrive."""

from __future__ import annotations

import os
import sys
from types import TracebackType

import cv2

from mien.arrays import Pixels
from mien.errors import MienError, require
from mien.files import printable

_KEYS = (27, ord("q"))
"""Escape and q close the window."""
_MAXIMUM_WIDTH = 1280
"""Largest initial width of a window, in pixels."""


def require_screen() -> None:
    """Raise MienError if there is no screen, as OpenCV would end the process."""
    headless = sys.platform == "linux" and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
    require(not headless, "there is no screen to show the video on; write an overlay instead")


class Window:
    """A window on the screen; Escape, q, or closing it interrupts the program like Ctrl-C.

    with Window("face") as window:
        window.show(pixels)
    Raises MienError if there is no screen.
    """

    def __init__(self, title: str) -> None:
        require_screen()
        # OpenCV would crash at the name of a file that is not valid UTF-8.
        self.title, self._size = printable(title), (0, 0)
        try:
            cv2.namedWindow(self.title, cv2.WINDOW_NORMAL | cv2.WINDOW_KEEPRATIO | cv2.WINDOW_GUI_NORMAL)
        except cv2.error as error:
            raise MienError("this OpenCV cannot show a video; write an overlay instead") from error

    def __enter__(self) -> Window:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._is_open():
            cv2.destroyWindow(self.title)

    def show(self, pixels: Pixels) -> None:
        """Show (H, W, 3) RGB pixels now. Raises KeyboardInterrupt when the user closes the window."""
        height, width = pixels.shape[:2]
        if (width, height) != self._size:
            self._size, shrink = (width, height), min(1.0, _MAXIMUM_WIDTH / width)
            cv2.resizeWindow(self.title, round(shrink * width), round(shrink * height))
        cv2.imshow(self.title, cv2.cvtColor(pixels, cv2.COLOR_RGB2BGR))
        key = cv2.waitKey(1) & 0xFF
        if key in _KEYS or not self._is_open():
            raise KeyboardInterrupt

    def _is_open(self) -> bool:
        return cv2.getWindowProperty(self.title, cv2.WND_PROP_VISIBLE) >= 1
