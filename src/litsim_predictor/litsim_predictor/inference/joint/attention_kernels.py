"""Attention to neighbours, as compiled kernels in single precision: see :mod:`.network`.

The k-th neighbours of many agents are processed at a time. These agents are the last dimension of arrays, the lanes.
"""

from __future__ import annotations

import math

import numpy as np

from litsim_predictor.inference.dense_kernels import INNER, add_product, exp, rectify
from litsim_predictor.inference.joint.units import LANE, NEAR
from litsim_predictor.inference.product_blocks import multiply_add
from litsim_sim.kernels.compiled import (
    Floats2,
    Ints,
    Ints2,
    OutInts,
    OutInts2,
    OutSingles,
    OutSingles2,
    OutSingles3,
    Singles,
    Singles2,
    Singles3,
    float32,
    kernel,
)

SUMS = 8  # of products, kept beside each other, so that the processor adds to all of them at once
LANES_MULTIPLE = 16  # of which the number of lanes is a multiple; those beyond the last agent are padding


@kernel
def find_neighbours(position: Singles2, i: int, reach: float, near: OutInts, far: OutSingles) -> int:
    """Find the nearest neighbours of agent `i` of n: at most K - 1, the lowest rows first where distances are equal.

    Args:
        position: (n, 2) [m].
        i: row of the agent.
        reach: distance within which neighbours are looked for [m].
        near: (K,) rows of the agent itself, first, and of its neighbours by distance; undefined beyond the number that
            is returned.
        far: (K,) is overwritten.
    """
    within, most = float32(reach * reach), len(near)
    near[0], used = i, 1
    for j in range(len(position)):
        dx, dy = position[j, 0] - position[i, 0], position[j, 1] - position[i, 1]
        apart = dx * dx + dy * dy
        if j == i or apart >= within or (used == most and apart >= far[used - 1]):
            continue
        used = min(used + 1, most)  # where there are too many, the farthest is dropped
        place = used - 1
        while place > 1 and far[place - 1] > apart:
            far[place], near[place] = far[place - 1], near[place - 1]
            place -= 1
        far[place], near[place] = apart, j
    return used


@kernel
def relate_neighbours(
    frame: Floats2,
    speed: Singles,
    begins: Ints,
    rows: Ints,
    reach: float,
    index: OutInts2,
    many: OutInts,
    relation: OutSingles3,
) -> None:
    """Find the nearest neighbours of some of n agents of several scenes, and write their relations to these.

    Args:
        frame: (n, 3) x, y [m] and heading [rad] of the agent frames.
        speed: (n,) [m/s].
        begins: (S,) rows at which the scenes begin.
        rows: (m,) of the agents whose neighbours are found; of others, what is written is undefined.
        reach: distance within which neighbours are looked for [m].
        index: (n, K) rows of the agent itself, first, and of its neighbours; undefined from `many` on.
        many: (n,) number of rows in `index`, the agent included.
        relation: (n, K, RELATION_CHANNELS); see :data:`.units.RELATION_UNITS`. Undefined where `index` is.
    """
    position, far = np.empty((len(frame), 2), np.float32), np.zeros(index.shape[1], np.float32)
    cos, sin = np.empty(len(frame), np.float32), np.empty(len(frame), np.float32)
    for scene in range(len(begins)):
        begin, end = begins[scene], begins[scene + 1] if scene + 1 < len(begins) else len(frame)
        for i in range(begin, end):  # places relative to the first agent of the scene: single precision is fine there
            position[i, 0], position[i, 1] = frame[i, 0] - frame[begin, 0], frame[i, 1] - frame[begin, 1]
            heading = float32(frame[i, 2])
            cos[i], sin[i] = math.cos(heading), math.sin(heading)
    for i in rows:
        scene = np.searchsorted(begins, i, "right")
        begin, end = begins[scene - 1], begins[scene] if scene < len(begins) else len(frame)
        many[i] = find_neighbours(position[begin:end], i - begin, reach, index[i], far)
        index[i] += begin
        for k in range(many[i]):
            j, channels = index[i, k], relation[i, k]
            dx, dy = position[j, 0] - position[i, 0], position[j, 1] - position[i, 1]
            ahead, left = cos[i] * dx + sin[i] * dy, cos[i] * dy - sin[i] * dx
            channels[0], channels[1], channels[2] = ahead, left, float32(1.0) / (abs(ahead) + float32(NEAR))
            channels[3], channels[4] = cos[j] * cos[i] + sin[j] * sin[i], sin[j] * cos[i] - cos[j] * sin[i]
            channels[5], channels[6], channels[7] = speed[j] - speed[i], speed[j], float32(0.0)
            if abs(left) < float32(0.5 * LANE) and ahead != float32(0.0):
                channels[7] = float32(1.0) if ahead > float32(0.0) else float32(-1.0)


@kernel
def read_relations(
    relation: Singles3, rows: Ints, many: Ints, weight: Singles2, bias: Singles, near: OutSingles3
) -> None:
    """Write to `near` (K, c, lanes) the output of the rectified layer that reads relations; see :func:`attend`."""
    channels = relation.shape[2]
    neighbours, width, lanes = near.shape
    laid_out = np.zeros((channels, lanes), np.float32)
    for k in range(neighbours):
        for i in range(len(rows)):
            for f in range(channels):
                laid_out[f, i] = relation[rows[i], k, f] if k < many[rows[i]] else float32(0.0)
        for c in range(width):
            near[k, c] = bias[c]
        add_product(weight, laid_out, near[k])
        rectify(near[k])


@kernel
def weigh_relations(query: Singles2, of_key: Singles3, near: Singles3, logits: OutSingles3) -> None:
    """Add to `logits` (K, heads, lanes) the products of queries and of what relations add to keys; see :func:`attend`.

    `near` (K, c, lanes) are the relations as :func:`read_relations` writes them.
    """
    heads, width, size = of_key.shape
    neighbours, lanes = near.shape[0], near.shape[2]
    part, by_relation = np.zeros((size, lanes), np.float32), np.empty((width, lanes), np.float32)
    for head in range(heads):
        for i in range(len(query)):
            for d in range(size):
                part[d, i] = query[i, head * size + d]
        by_relation[:] = float32(0.0)
        add_product(of_key[head], part, by_relation)
        for k in range(neighbours):
            logit = logits[k, head]
            for c in range(0, width, INNER):
                a0, a1, a2, a3 = by_relation[c], by_relation[c + 1], by_relation[c + 2], by_relation[c + 3]
                n0, n1, n2, n3 = near[k, c], near[k, c + 1], near[k, c + 2], near[k, c + 3]
                for i in range(lanes):
                    total = multiply_add(a1[i], n1[i], multiply_add(a0[i], n0[i], logit[i]))
                    logit[i] = multiply_add(a3[i], n3[i], multiply_add(a2[i], n2[i], total))


@kernel
def weigh_keys(query: Singles2, rows: Ints, key_value: Singles2, index: Ints2, many: Ints, logits: OutSingles3) -> None:
    """Add to `logits` (K, heads, lanes) the products of queries and the keys of neighbours; see :func:`attend`."""
    heads, size = logits.shape[1], query.shape[1] // logits.shape[1]
    whole, sums = size - size % SUMS, np.empty(SUMS, np.float32)
    for i in range(len(rows)):
        row, own = rows[i], query[i]
        for k in range(many[row]):
            key = key_value[index[row, k]]
            for head in range(heads):
                begin = head * size
                sums[:] = float32(0.0)
                for j in range(begin, begin + whole, SUMS):
                    for lane in range(SUMS):
                        sums[lane] = multiply_add(own[j + lane], key[j + lane], sums[lane])
                a, b = (sums[0] + sums[4]) + (sums[2] + sums[6]), (sums[1] + sums[5]) + (sums[3] + sums[7])
                total = a + b
                for j in range(begin + whole, begin + size):
                    total += own[j] * key[j]
                logits[k, head, i] += total


@kernel
def softmax(rows: Ints, many: Ints, weights: OutSingles3) -> None:
    """Replace logits, `weights` (K, heads, lanes), by their softmax over the neighbours that each agent has."""
    neighbours, heads, lanes = weights.shape
    valid = np.ones(lanes, np.int64)
    for i in range(len(rows)):
        valid[i] = many[rows[i]]
    highest, total = np.empty(lanes, np.float32), np.empty(lanes, np.float32)
    for head in range(heads):
        highest[:] = weights[0, head]
        total[:] = float32(0.0)
        for k in range(1, neighbours):
            logit = weights[k, head]
            for i in range(lanes):
                highest[i] = max(highest[i], logit[i]) if k < valid[i] else highest[i]
        for k in range(neighbours):
            logit = weights[k, head]
            for i in range(lanes):
                logit[i] = exp(logit[i] - highest[i]) if k < valid[i] else float32(0.0)
                total[i] += logit[i]
        for k in range(neighbours):
            logit = weights[k, head]
            for i in range(lanes):
                logit[i] /= total[i]


@kernel
def sum_values(weights: Singles3, rows: Ints, key_value: Singles2, index: Ints2, many: Ints, out: OutSingles2) -> None:
    """Write to `out` (m, W) the sums of neighbours' values times `weights` (K, heads, lanes); see :func:`attend`."""
    heads, channels = weights.shape[1], out.shape[1]
    size = channels // heads
    for i in range(len(rows)):
        row = rows[i]
        out[i] = float32(0.0)
        for k in range(many[row]):
            other = key_value[index[row, k]]
            for head in range(heads):
                weight = weights[k, head, i]
                sums, value = out[i, head * size :], other[channels + head * size :]
                for d in range(size):
                    sums[d] = multiply_add(weight, value[d], sums[d])


@kernel
def sum_relations(weights: Singles3, near: Singles3, of_value: Singles3, out: OutSingles2) -> None:
    """Add to `out` (m, W) the sums of what relations add to values, times `weights` (K, heads, lanes).

    `near` (K, c, lanes) are the relations as :func:`read_relations` writes them; for `of_value` see :func:`attend`.
    """
    heads, size, width = of_value.shape
    neighbours, lanes = near.shape[0], near.shape[2]
    last = neighbours - neighbours % INNER
    weighted, added = np.empty((width, lanes), np.float32), np.empty((size, lanes), np.float32)
    for head in range(heads):
        weighted[:] = float32(0.0)
        for k in range(0, last, INNER):
            w0, w1, w2, w3 = weights[k, head], weights[k + 1, head], weights[k + 2, head], weights[k + 3, head]
            for c in range(width):
                n0, n1, n2, n3, sums = near[k, c], near[k + 1, c], near[k + 2, c], near[k + 3, c], weighted[c]
                for i in range(lanes):
                    total = multiply_add(w1[i], n1[i], multiply_add(w0[i], n0[i], sums[i]))
                    sums[i] = multiply_add(w3[i], n3[i], multiply_add(w2[i], n2[i], total))
        for k in range(last, neighbours):
            weight = weights[k, head]
            for c in range(width):
                channel, sums = near[k, c], weighted[c]
                for i in range(lanes):
                    sums[i] = multiply_add(weight[i], channel[i], sums[i])
        added[:] = float32(0.0)
        add_product(of_value[head], weighted, added)
        for i in range(len(out)):
            for d in range(size):
                out[i, head * size + d] += added[d, i]


@kernel
def attend(  # noqa: PLR0917 - a kernel takes arrays and numbers
    query: Singles2,
    rows: Ints,
    key_value: Singles2,
    index: Ints2,
    many: Ints,
    relation: Singles3,
    out: OutSingles2,
    weight: Singles2,
    bias: Singles,
    of_key: Singles3,
    of_value: Singles3,
) -> None:
    """Attend to neighbours, whose keys and values also hold how they lie and move relative to the agent that attends.

    Args:
        query: (m, W) of the agents in the `rows` (m,) of all n.
        key_value: (n, 2 W) keys, then values.
        index, many, relation: see :func:`relate_neighbours`.
        out: (m, W) sums of the neighbours' values, weighted by attention.
        weight, bias: (c, RELATION_CHANNELS) and (c,) of the rectified layer that reads a relation.
        of_key, of_value: (heads, c, W / heads) and (heads, W / heads, c) matrices by which the output of that layer is
            added to keys and values. They are taken out of the sums over neighbours, and applied once for each agent.
    """
    heads, width, _ = of_key.shape
    lanes = -(-len(rows) // LANES_MULTIPLE) * LANES_MULTIPLE
    near = np.empty((index.shape[1], width, lanes), np.float32)
    weights = np.zeros((index.shape[1], heads, lanes), np.float32)
    read_relations(relation, rows, many, weight, bias, near)
    weigh_relations(query, of_key, near, weights)
    weigh_keys(query, rows, key_value, index, many, weights)
    softmax(rows, many, weights)
    sum_values(weights, rows, key_value, index, many, out)
    sum_relations(weights, near, of_value, out)
