"""Centralities of road users in their proximity graph, for batches of graphs.

Two agents within a radius are joined by an edge. The length of an edge is their distance in units of the radius, and
its weight is one minus the length, so that edges appear and vanish continuously. Each centrality is computed within the
agent's connected component, and does not depend on the rest of the graph. The graphs (..., N, N) are processed at once,
in N steps (Floyd and Warshall) or by matrix products.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar, cast

import torch
from torch import Tensor

from litsim_research.predictors.models.model import diagonal

Function = TypeVar("Function", bound=Callable[..., Any])

CENTRALITIES = ("degree", "closeness", "eigenvector", "betweenness", "power", "katz")
ATTENUATION = 0.1
"""Factor by which each edge of a walk attenuates it: Katz's alpha, and minus Bonacich's beta. With a tenth both series
converge in traffic, where the weights of an agent's edges add up to about 5 at most."""
CONVERGENCE = 0.9
"""Largest product of attenuation and weighted degree; the attenuation is reduced where many agents are very close."""
SQUARINGS = 10  # squarings of the power iteration, which thus makes 2^10 steps
SERIES = 7  # squarings in a series: powers up to 2^8 - 1, whose norm is below 1e-11
TIE = 1e-5  # difference up to which two paths count as equally long, in radii
SHORTEST_EDGE = 1e-3  # least length of an edge, in radii
CHUNK = 1 << 17  # entries of the matrices that are processed at a time, so that they stay in the cache


def proximity_graph(point: Tensor, present: Tensor, radius: float) -> Tensor:
    """Returns edge lengths (..., N, N) in radii; infinite where there is no edge, and zero on the diagonal.

    Args:
        point: (..., N, 2) positions [m].
        present: (..., N) bool; absent agents have no edges.
        radius: distance within which agents are joined [m].
    """
    apart = (point[..., :, None, :] - point[..., None, :, :]).norm(dim=-1) / radius
    itself = diagonal(point[..., 0])
    joined = present[..., :, None] & present[..., None, :] & (apart < 1.0) & ~itself
    return torch.where(joined, apart.clamp_min(SHORTEST_EDGE), torch.inf).masked_fill(itself, 0.0)


@torch.no_grad()
def centralities(length: Tensor) -> Tensor:
    """Returns the :data:`CENTRALITIES` (..., N, 6) of all agents; 0 without edges, except where 1 is stated.

    - degree: sum of the weights of the agent's edges;
    - closeness: inverse of the mean length of the shortest paths to the others;
    - eigenvector: that of the largest eigenvalue of the weights W, with norm 1 in each component (1 without edges);
    - betweenness: share of the pairs of others whose shortest path contains the agent; if a pair has several, each
      counts in part;
    - power, of Bonacich (1987): ``(I - beta W)^-1 W 1`` with a negative beta, with which agents are weak whose
      neighbours are powerful; a positive one would repeat Katz's centrality;
    - Katz's: ``(I - alpha W)^-1 1`` (1 without edges).

    Args:
        length: (..., N, N) symmetric edge lengths below 1, infinite where there is no edge, zero on the diagonal.
    """
    if torch.onnx.is_in_onnx_export():  # one scene, and the number of its agents must not become a constant
        return _centralities(length.flatten(0, 1)).unflatten(0, length.shape[:2])
    size = length.shape[-1]
    chunks = length.reshape(-1, size, size).split(max(1, CHUNK // max(1, size**2)))
    return torch.cat([_centralities(chunk) for chunk in chunks]).reshape(*length.shape[:-1], len(CENTRALITIES))


def _centralities(graphs: Tensor) -> Tensor:
    """See :func:`centralities`: (G, N, 6) for the edge lengths `graphs` (G, N, N)."""
    weight = torch.where(torch.isfinite(graphs), 1.0 - graphs, 0.0).masked_fill(diagonal(graphs), 0.0)
    distance, ways = shortest_ways(graphs)
    near = torch.isfinite(distance)
    degree = weight.sum(dim=-1)
    power, katz = _walks(weight, (degree[:, None, :] * near).amax(dim=-1))
    measures = [
        degree,
        _closeness(distance, near),
        _eigenvector(weight, near),
        _betweenness(distance, ways, near),
        power,
        katz,
    ]
    return torch.stack(measures, dim=-1)


def shortest_ways(length: Tensor) -> tuple[Tensor, Tensor]:
    """Returns lengths and numbers (G, N, N) of the shortest paths between all agents, 0 on the diagonal."""
    joined = torch.isfinite(length).to(length.dtype).masked_fill(diagonal(length), 0.0)
    return _as_loop(_let_in)(length, joined, TIE)


def _as_loop(function: Function) -> Function:
    """Returns `function`; during an export it is scripted, since a trace would unroll its loops over agents."""
    return cast(Function, torch.jit.script(function)) if torch.onnx.is_in_onnx_export() else function


def _let_in(distance: Tensor, ways: Tensor, tie: float) -> tuple[Tensor, Tensor]:
    """Floyd and Warshall's algorithm; a path is counted once, in the step of its last intermediate agent by index."""
    for k in range(distance.shape[-1]):
        far, many = distance.select(1, k), ways.select(1, k)  # from or to k alike: the graphs are undirected
        via = far.unsqueeze(2) + far.unsqueeze(1)
        more = many.unsqueeze(2) * many.unsqueeze(1)
        gain = distance - via  # NaN where both are infinite; all comparisons with it are false
        ways = torch.where(gain > tie, more, torch.where(gain >= -tie, ways + more, ways))
        distance = torch.minimum(distance, via)
    return distance, ways


def mean_rates(series: Tensor, observed: Tensor, dt: float) -> Tensor:
    """Returns mean absolute rates of change (..., N, F, C) of each channel from the first frame to each frame [1/s].

    Args:
        series: (..., N, F, C) values, oldest first.
        observed: (..., N, F) bool; changes from or to frames that are not observed do not count.
        dt: time between frames [s].
    """
    both = (observed[..., 1:] & observed[..., :-1])[..., None].to(series.dtype)
    changes = (series[..., 1:, :] - series[..., :-1, :]).abs()
    total = torch.cumsum(changes * both, dim=-2)
    count = torch.cumsum(both, dim=-2).clamp_min(1.0)
    return torch.nn.functional.pad(total / (count * dt), (0, 0, 1, 0))


def _closeness(distance: Tensor, near: Tensor) -> Tensor:
    total = distance.masked_fill(~near, 0.0).sum(dim=-1)
    return torch.where(total > 0.0, (near.sum(dim=-1) - 1) / total.clamp_min(SHORTEST_EDGE), 0.0)


def _eigenvector(weight: Tensor, near: Tensor) -> Tensor:
    """Power iteration from equal values, by squaring the matrix; the identity is added to prevent oscillation."""
    matrix = weight + diagonal(weight)
    for _ in range(SQUARINGS):
        matrix = matrix @ matrix
        largest = (matrix.amax(dim=-1)[:, None, :] * near).amax(dim=-1)  # in each component
        matrix = matrix / largest[..., None]
    vector = matrix.sum(dim=-1)
    return vector / ((vector**2)[:, None, :] * near).sum(dim=-1).sqrt()


def _betweenness(distance: Tensor, ways: Tensor, near: Tensor) -> Tensor:
    share = torch.where(ways > 0.0, 1.0 / ways, 0.0)
    total = _as_loop(_between)(distance, ways, share, TIE)
    others = near.sum(dim=-1) - 1
    return total / (others * (others - 1)).clamp_min(1)


def _between(distance: Tensor, ways: Tensor, share: Tensor, tie: float) -> Tensor:
    """Returns the number (G, N) of ordered pairs of others whose shortest paths contain each agent.

    A path counts as the `share` (G, N, N) of its pair: the inverse of the pair's number of shortest paths.
    """
    total = torch.zeros_like(distance[:, 0])
    nobody = torch.zeros_like(share)
    longest = distance + tie
    place = torch.arange(distance.shape[-1], device=distance.device)
    for k in range(distance.shape[-1]):
        far, many = distance.select(1, k), ways.select(1, k)
        through = torch.where(far.unsqueeze(2) + far.unsqueeze(1) <= longest, share, nobody)
        pairs = (many * (through @ many.unsqueeze(2)).squeeze(2)).sum(dim=-1)
        total = total + pairs.unsqueeze(1) * (place == k)
    return total


def _walks(weight: Tensor, degree_max: Tensor) -> tuple[Tensor, Tensor]:
    """Returns Bonacich's power and Katz's centrality (G, N); `degree_max` (G, N) is the component's largest degree.

    The inverses are geometric series of the attenuated weights A, whose norm is at most CONVERGENCE. The product of
    ``I + A^2``, ``I + A^4``, ... contains all even powers up to the last; multiplied by ``I - A`` it is the series of
    ``(I + A)^-1``, and multiplied by ``I + A`` that of ``(I - A)^-1``.
    """
    once = (CONVERGENCE / degree_max.clamp_min(1e-6)).clamp_max(ATTENUATION)[..., None] * weight
    degree = weight.sum(dim=-1, keepdim=True)
    walks = torch.cat([degree, torch.ones_like(degree)], dim=-1)
    power = once
    for _ in range(SERIES):
        power = power @ power
        walks = walks + power @ walks
    further = once @ walks
    return walks[..., 0] - further[..., 0], walks[..., 1] + further[..., 1]
