"""Collisions of rectangles as highway-env finds them: arrays in, arrays out, one entry for each pair.

Two tests (`RoadObject._is_colliding`, `utils.are_polygons_intersecting`): circles around both, then the separating
axis theorem, now and displaced by one frame's motion. A car that was pushed out of another stands exactly at contact
in the next frame, so that the last bit decides what happens then. Therefore the arithmetic is highway-env's to the
last bit: its dot products are NumPy's `vecdot`, its rotation `matmul`, which make the same BLAS calls.
"""

import numpy as np

ALONG, ACROSS = np.array([-0.5, -0.5, 0.5, 0.5]), np.array([-0.5, 0.5, 0.5, -0.5])
NEXT_CORNER = np.array([1, 2, 3, 0])

Lengths = np.ndarray | float


def corners(position: np.ndarray, direction: np.ndarray, length: Lengths, width: Lengths) -> np.ndarray:
    """Return the corners of rectangles, in order around them, shape (..., 4, 2) [m].

    Args:
        position: centres, shape (..., 2).
        direction: cosine and sine of the headings, shape (..., 2).
        length: along the heading, one for all or shape (...) [m].
        width: across it, likewise.
    """
    points = np.empty((*np.shape(length), 4, 2))
    np.multiply.outer(length, ALONG, out=points[..., 0])
    np.multiply.outer(width, ACROSS, out=points[..., 1])
    rotation = np.empty((*direction.shape, 2))
    rotation[..., 0] = direction
    rotation[..., 1, 1] = direction[..., 0]
    np.negative(direction[..., 1], out=rotation[..., 0, 1])
    turned = (rotation @ points.swapaxes(-1, -2)).swapaxes(-1, -2)
    placed: np.ndarray = np.add(turned, position[..., None, :], order="C")
    return placed


def out_of_reach(offset: np.ndarray, diagonal: Lengths, other: Lengths, travel: Lengths) -> np.ndarray:
    """Return where two circles around the rectangles are apart, which highway-env asks first.

    As there, `travel` is the first car's signed way in one frame: in reverse, the circles shrink.

    Args:
        offset: from the first centre to the second, shape (..., 2).
        diagonal, other: of the two rectangles, of a shape broadcastable to (...) [m].
        travel: speed times dt of the first, likewise.
    """
    apart: np.ndarray = np.sqrt(np.vecdot(offset, offset)) > (diagonal + other) / 2 + travel
    return apart


def separating_axis(polygons: np.ndarray, displacement: np.ndarray) -> tuple[np.ndarray, ...]:
    """Test pairs of convex quadrilaterals, a and b, by the separating axis theorem.

    Args:
        polygons: corners of a and b, shape (n, 2, 4, 2).
        displacement: of a relative to b within the next frame, shape (n, 2).

    Returns:
        intersecting: whether they overlap now, shape (n,).
        will_intersect: whether they will overlap when displaced, shape (n,).
        translation: what would push a out of b then, shape (n, 2); meaningless where they will not overlap.
    """
    n = len(polygons)
    edges = polygons.take(NEXT_CORNER, axis=2) - polygons
    normals = np.empty((n, 8, 2))
    np.negative(edges[..., 1].reshape(n, 8), out=normals[..., 0])
    normals[..., 1] = edges[..., 0].reshape(n, 8)
    normals /= np.sqrt(np.vecdot(normals, normals))[..., None]
    shadows = np.vecdot(polygons.transpose(2, 1, 0, 3)[:, :, :, None], normals)  # (4, 2, n, 8)
    low_a, low_b = np.minimum.reduce(shadows)
    high_a, high_b = np.maximum.reduce(shadows)
    apart = (low_b > high_a) | (low_a > high_b)

    motion = np.vecdot(normals, np.ascontiguousarray(displacement)[:, None])
    low_a += np.minimum(motion, 0)
    high_a += np.maximum(motion, 0)
    # Signed distance of the shadows; where they overlap it is negative, and not always the whole overlap.
    gap = np.where(low_a < low_b, low_b - high_a, low_a - high_b)
    will_be_apart = gap > 0

    overlap = np.abs(gap)
    axis = overlap.argmin(axis=1)
    pairs = np.arange(n)
    normal = normals[pairs, axis]
    centres = np.add.reduce(polygons, axis=2) / 4
    away = np.where(np.vecdot(centres[:, 0] - centres[:, 1], normal) > 0, 1.0, -1.0)
    translation = (overlap[pairs, axis] * away)[:, None] * normal
    return ~apart.any(axis=1), ~will_be_apart.any(axis=1), translation
