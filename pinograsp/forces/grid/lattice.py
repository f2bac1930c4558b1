"""The multiplier grid of one cell: its first point, in grid order, whose net force is within the limit."""

from __future__ import annotations

import numpy as np

from pinograsp.spatial import Array, IntArray

_NODES = 2**14  # nodes expanded at once: small enough that a solution near the front is found early


def first_on_lattice(
    units: Array, normal_forces: Array, load: Array, values: Array, columns: Array, limit: float
) -> IntArray | None:
    """Indices (k, 2) into ``values`` of the first multipliers that leave at most ``limit`` [N], or None.

    Depth first over the contacts in grid order. A partial choice is dropped when no *continuous* multipliers of the
    remaining contacts could bring the net wrench within the limit, tested along directions that bound their
    zonotope, so no solution is lost.

    Args:
        units: (k, nk^2, rows) unit contact wrenches.
        normal_forces: (k,) [N].
        load: (rows,) [N].
        values: (nk,) multipliers.
        columns: (rows, k, 2) tangential directions times mu F / sqrt(2) [N].
    """
    k, per_contact, rows = units.shape
    steps = units * normal_forces[:, None, None]
    middle, half = (values[0] + values[-1]) / 2, (values[-1] - values[0]) / 2
    tests = []
    for i in range(k - 1):
        remaining = columns[:, i + 1 :].reshape(rows, -1)
        directions = _directions(remaining)
        # What the remaining contacts add along each direction: a fixed part and a symmetric reach.
        fixed = (steps[i + 1 :, 0].sum(axis=0) + remaining.sum(axis=1) * (middle - values[0])) @ directions.T
        reach = half * np.abs(directions @ remaining).sum(axis=1)
        tests.append((directions, fixed, reach + limit * (1 + 1e-9) + 1e-12))

    def descend(i: int, net: Array, path: IntArray) -> IntArray | None:
        for first in range(0, len(net), max(1, _NODES // per_contact)):
            part = slice(first, first + max(1, _NODES // per_contact))
            expanded = (net[part, None, :] + steps[i]).reshape(-1, rows)
            if i == k - 1:
                hit = np.flatnonzero(np.einsum("nr,nr->n", expanded, expanded) <= limit**2)[:1]
            else:
                directions, fixed, reach = tests[i]
                hit = np.flatnonzero(np.all(np.abs(expanded @ directions.T + fixed) <= reach, axis=1))
            if hit.size:
                paths = np.column_stack([path[first + hit // per_contact], hit % per_contact])
                found = paths[0] if i == k - 1 else descend(i + 1, expanded[hit], paths)
                if found is not None:
                    return found
        return None

    found = descend(0, load[None], np.zeros((1, 0), dtype=int))
    return None if found is None else np.stack(np.divmod(found, values.size), axis=1)


def _directions(generators: Array) -> Array:
    """Unit directions (d, rows) along which the zonotope of ``generators`` (rows, m) is bounded tightly.

    Directions outside its span bound it to zero; inside, the dual basis bounds each coefficient where the generators
    are independent, and in three dimensions the facet normals (cross products of pairs) describe it exactly.
    """
    rows, m = generators.shape
    U, sigma, _Vt = np.linalg.svd(generators)
    rank = int(np.sum(sigma > 1e-10 * max(sigma[0], 1e-300))) if m else 0
    found = [U[:, rank:].T]
    if rank == m and rank:
        found.append(np.linalg.pinv(generators))
    elif rows == 3 and rank == 3:
        a, b = np.triu_indices(m, 1)
        found.append(np.cross(generators[:, a].T, generators[:, b].T))
    elif rank:
        found += [U[:, :rank].T, generators.T]
    directions = np.concatenate(found)
    length = np.linalg.norm(directions, axis=1)
    keep = length > 1e-9 * max(float(length.max(initial=0.0)), 1e-300)
    units: Array = directions[keep] / length[keep, None]
    return units
