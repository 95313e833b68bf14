"""A rotation that float32 rounds to a given matrix, so that a pose survives being stored as a quaternion."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linprog
from scipy.spatial.transform import Rotation

Floats = NDArray[np.float64]

ITERATIONS = 3  # each solves a linearized problem; the second already moves by rounding errors only
UNIT = 2.0**-24  # half the spacing of float32 just below 1: the solver's unit of length


def exact_rotation(matrix: NDArray[np.float32]) -> Floats:
    """The rotation [3, 3] in float64 that lies deepest among those that round to `matrix`.

    A quaternion holds only rotations, and a matrix of float32 numbers is not quite one: the nearest rotation rounds to
    another matrix, off by some last bits. But where the matrix came from rounding a rotation, some rotation rounds to
    it. With R the present guess and Δ = matrix − R, a small turn ω changes R by [ω]×·R, linear in ω; sought is the ω of

        min s  subject to  |([ω]×·R − Δ)ᵢⱼ| ≤ s·hᵢⱼ

    where hᵢⱼ is half the spacing of float32 at matrixᵢⱼ: every s < 1 will do. An element that is zero allows no error
    at all; it is met to float64's accuracy, some 1e-17, which readers take for zero.

    Where the matrix is no rounded rotation, as when it was inverted in float32, the result is still the one with the
    least s, and some last bits differ.
    """
    target = matrix.astype(np.float64)
    left, _, right = np.linalg.svd(target)
    rotation = left @ right
    for _ in range(ITERATIONS):
        rotation = Rotation.from_rotvec(_best_turn(rotation, target, matrix)).as_matrix() @ rotation
    return rotation


def _best_turn(rotation: Floats, target: Floats, matrix: NDArray[np.float32]) -> Floats:
    """The rotation vector ω [3] of the linear program."""
    # column k of `change` is what a turn about axis k does to the nine elements
    change = np.stack([(np.cross(axis, rotation.T).T).reshape(-1) for axis in np.eye(3)], axis=1)
    missing = (target - rotation).reshape(-1)
    zero = target.reshape(-1) == 0
    fixed, free = _solutions(change[zero], missing[zero])
    if not free.shape[1]:
        return fixed
    slack = (np.spacing(np.abs(matrix)).astype(np.float64).reshape(-1) / 2)[~zero]
    slope = (change[~zero] @ free) / slack[:, None] * UNIT
    offset = (missing[~zero] - change[~zero] @ fixed) / slack
    ones = np.ones((len(slack), 1))
    found = linprog(
        c=[*np.zeros(free.shape[1]), 1.0],
        A_ub=np.block([[slope, -ones], [-slope, -ones]]),
        b_ub=np.concatenate([offset, -offset]),
        bounds=[(None, None)] * (free.shape[1] + 1),
    )
    return fixed + free @ (found.x[:-1] * UNIT) if found.success else fixed


def _solutions(rows: Floats, values: Floats) -> tuple[Floats, Floats]:
    """All ω with rows·ω = values: the shortest [3], and a basis [3, N] of what may be added to it."""
    if not len(rows):
        return np.zeros(3), np.eye(3)
    left, sizes, right = np.linalg.svd(rows)
    rank = int((sizes > 1e-9).sum())
    shortest = right[:rank].T @ ((left[:, :rank].T @ values) / sizes[:rank])
    return shortest, right[rank:].T
