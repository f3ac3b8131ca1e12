"""Captions on the frames of videos."""

import numpy as np
from PIL import Image, ImageDraw

LAST_FRAME_S = 1.0  # how long the end of an episode is shown


def add_caption(frame: np.ndarray, text: str) -> np.ndarray:
    """Return a frame, shape (height, width, 3), with a text in its corner."""
    image = Image.fromarray(frame)
    ImageDraw.Draw(image).text(
        (8, 6), text, fill="white", stroke_width=1, stroke_fill="black", font_size=16
    )
    return np.asarray(image)
