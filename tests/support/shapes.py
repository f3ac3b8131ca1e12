"""Rectangles by Shapely, as a reference of our own geometry."""

import shapely


def polygon(x, y, heading, length, width):
    """A rectangle with this centre, whose length is along its heading."""
    box = shapely.box(-length / 2, -width / 2, length / 2, width / 2)
    turned = shapely.affinity.rotate(box, heading, origin=(0, 0), use_radians=True)
    return shapely.affinity.translate(turned, x, y)
