"""Points at which a box of commands is searched; their number does not grow with a power of its dimensions."""

import numpy as np

from stepgap.step import Array


def box_points(count: int, k: int) -> Array:
    """About `count` points over |point| ≤ 1: an even grid of one or two axes; of more, a design and scattered points.

    The first ones are those of `composite_design`. Each further one is the one before plus a vector of irrational steps
    that hardly resonate, modulo the box (the R-sequence: Roberts, The unreasonable effectiveness of quasirandom
    sequences, 2018).

    Args:
        count: Number of points; a grid has the nearest number of points along each axis, at least 3.
        k: Number of coordinates.

    Returns:
        Shape (N, k).
    """
    if k <= 2:
        return box_grid(max(3, round(count ** (1 / k))), k).reshape(-1, k)
    design = composite_design(k)
    scattered = np.outer(np.arange(1, max(count - len(design), 0) + 1), irrational_steps(k))
    return np.concatenate([design, 2 * np.mod(0.5 + scattered, 1.0) - 1])[:count]


def box_grid(samples: int, k: int) -> Array:
    """Even grid over |point| ≤ 1, its ends included; shape (samples, …, samples, k)."""
    return np.stack(np.meshgrid(*[np.linspace(-1, 1, samples)] * k, indexing="ij"), axis=-1)


def composite_design(k: int) -> Array:
    """Middle, ends of each axis and 2 to 4 k corners of |point| ≤ 1; of up to three axes, all corners.

    It is a face-centred central composite design (Box and Wilson, On the experimental attainment of optimum conditions,
    1951). The corners are the rows of a Hadamard matrix and their opposites, so that any two axes meet in all four
    combinations.

    Args:
        k: Number of coordinates.

    Returns:
        Shape (N, k).
    """
    ends = np.repeat(np.eye(k), 2, axis=0) * np.tile([1.0, -1.0], k)[:, None]
    rows = np.arange(1 << (k - 1).bit_length())
    odd = np.array([[(row & axis).bit_count() % 2 for axis in range(k)] for row in rows.tolist()])
    corners = 1.0 - 2.0 * odd
    return np.concatenate([np.zeros((1, k)), ends, corners, -corners] if k > 1 else [np.zeros((1, 1)), ends])


def irrational_steps(k: int) -> Array:
    """Steps of the R-sequence: powers of the inverse of the root of x^(k+1) = x + 1; shape (k,)."""
    root = 1.5
    for _ in range(64):
        root = (1 + root) ** (1 / (k + 1))
    return root ** -np.arange(1.0, k + 1)
