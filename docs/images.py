"""The pictures of the README, from the demo's own output: `mien demo && python docs/images.py`."""

from __future__ import annotations

from pathlib import Path

import av
import cv2
import numpy as np
from PIL import Image

DEMO, IMAGES = Path("mien-demo"), Path(__file__).parent / "images"
FRAMES = (20, 52, 75)
HEIGHT, PLOT_WIDTH = 240, 900


def main() -> None:
    IMAGES.mkdir(exist_ok=True)
    with av.open(str(DEMO / "overlay.mp4")) as container:
        frames = [f.to_ndarray(format="rgb24") for k, f in enumerate(container.decode(video=0)) if k in FRAMES]
    strip = np.hstack([_scaled(f, HEIGHT / f.shape[0]) for f in frames])
    Image.fromarray(strip).save(IMAGES / "demo.png", optimize=True)
    plot = cv2.cvtColor(cv2.imread(str(DEMO / "plot.png")), cv2.COLOR_BGR2RGB)
    small = Image.fromarray(_scaled(plot, PLOT_WIDTH / plot.shape[1]))
    small.save(IMAGES / "plot.png", optimize=True)


def _scaled(image: np.ndarray, scale: float) -> np.ndarray:
    return cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)


if __name__ == "__main__":
    main()
