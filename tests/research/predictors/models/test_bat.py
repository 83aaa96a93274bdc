"""BAT: centralities against networkx, what a target sees, and that the model learns."""

import itertools
from dataclasses import replace

import networkx as nx
import numpy as np
import pytest
import torch
from hypothesis import assume, given
from hypothesis import strategies as st
from torch import Tensor

from litsim_predictor.inference.contract import DT, HISTORY, HORIZON
from litsim_predictor.inference.joint.units import TRAFFIC_CHANNELS
from litsim_research.predictors.data.batch import SceneBatch, maneuvers_of
from litsim_research.predictors.models.bat import (
    CELL_LENGTH,
    CELL_WIDTH,
    Bat,
    BatParameters,
    motions_of,
    neighbours,
    polar,
)
from litsim_research.predictors.models.centrality import (
    ATTENUATION,
    CENTRALITIES,
    centralities,
    mean_rates,
    proximity_graph,
)
from litsim_research.predictors.models.model import negative_log_likelihood

TOLERANCE = {"rtol": 1e-4, "atol": 1e-4}


# Centralities


@st.composite
def graphs(draw: st.DrawFn, size_max: int = 8) -> nx.Graph:
    """Undirected, edges with a length below 1 and a weight of one minus that; sums of lengths are exact."""
    graph = nx.Graph()
    graph.add_nodes_from(range(draw(st.integers(1, size_max))))
    for one, other in itertools.combinations(graph, 2):
        sixteenths = draw(st.integers(1, 40))  # most pairs are too far apart
        if sixteenths < 16:
            graph.add_edge(one, other, length=sixteenths / 16, weight=1 - sixteenths / 16)
    return graph


def lengths(graph: nx.Graph, size: int | None = None) -> Tensor:
    matrix = torch.full((size or len(graph),) * 2, torch.inf, dtype=torch.float64).fill_diagonal_(0.0)
    for one, other, length in graph.edges(data="length"):
        matrix[one, other] = matrix[other, one] = length
    return matrix


def measured(graph: nx.Graph) -> dict[str, np.ndarray]:
    return dict(zip(CENTRALITIES, centralities(lengths(graph)).T.numpy(), strict=True))


def by_component(graph: nx.Graph, measure) -> np.ndarray:
    by_node = {}
    for component in nx.connected_components(graph):
        by_node |= measure(graph.subgraph(component))
    return np.array([by_node[node] for node in graph])


@given(graphs())
def test_centralities_are_those_of_networkx(graph: nx.Graph) -> None:
    def katz(component: nx.Graph) -> dict[int, float]:
        return nx.katz_centrality(component, ATTENUATION, tol=1e-12, normalized=False, weight="weight")

    values_of = measured(graph)
    expected = {
        "degree": np.array([degree for _, degree in graph.degree(weight="weight")]),
        "closeness": by_component(graph, lambda g: nx.closeness_centrality(g, distance="length")),
        "betweenness": by_component(graph, lambda g: nx.betweenness_centrality(g, weight="length")),
        "katz": by_component(graph, katz),
    }
    for name, values in expected.items():
        np.testing.assert_allclose(values_of[name], values, atol=1e-9, err_msg=name)


@given(graphs())
def test_eigenvector_centrality_is_that_of_networkx_in_each_component(graph: nx.Graph) -> None:
    def measure(component: nx.Graph) -> dict[int, float]:
        values = np.linalg.eigvalsh(nx.to_numpy_array(component))
        assume(len(values) < 2 or values[-1] - values[-2] > 0.05)  # else no iteration converges
        return nx.eigenvector_centrality(component, max_iter=5000, tol=1e-10, weight="weight")

    np.testing.assert_allclose(measured(graph)["eigenvector"], by_component(graph, measure), atol=1e-5)


@given(graphs())
def test_power_is_by_bonacichs_definition(graph: nx.Graph) -> None:
    """c(alpha, beta) = sum of (alpha + beta c_j) w_ij, with alpha 1 and a negative beta; networkx has none."""
    power = measured(graph)["power"]
    np.testing.assert_allclose(power, nx.to_numpy_array(graph) @ (1.0 - ATTENUATION * power), atol=1e-9)


@given(st.lists(graphs(), min_size=1, max_size=4))
def test_graphs_of_a_batch_do_not_touch_each_other_nor_does_padding(many: list[nx.Graph]) -> None:
    together = centralities(torch.stack([lengths(graph, 10) for graph in many]))
    for graph, values in zip(many, together, strict=True):
        torch.testing.assert_close(values[: len(graph)], centralities(lengths(graph)), rtol=0.0, atol=1e-9)
        assert (values[len(graph) :] == torch.tensor([0.0, 0.0, 1.0, 0.0, 0.0, 1.0], dtype=torch.float64)).all()


def test_who_stands_on_one_spot_has_finite_centralities() -> None:
    graph = proximity_graph(torch.zeros(40, 2), torch.ones(40, dtype=torch.bool), 10.0)
    values = centralities(graph)
    assert torch.isfinite(values).all() and (values[:, -1] < 20.0).all()


def test_the_graph_joins_who_is_near_and_present() -> None:
    point = torch.tensor([[0.0, 0.0], [6.0, 0.0], [6.0, 11.0], [3.0, 0.0]])
    present = torch.tensor([True, True, True, False])
    length = proximity_graph(point, present, 10.0)
    assert length[0, 1] == pytest.approx(0.6) and torch.equal(length, length.T)
    assert torch.isinf(length[[0, 1, 0, 3], [2, 2, 3, 1]]).all() and (length.diagonal() == 0.0).all()


def test_rates_are_means_of_what_was_seen_to_change() -> None:
    series = torch.tensor([5.0, 9.0, 8.0, 0.0, 8.0, 9.0])[:, None]
    observed = torch.tensor([True, True, True, False, True, True])
    rates = mean_rates(series, observed, 0.2)[:, 0]
    assert rates.tolist() == pytest.approx([0.0, 20.0, 12.5, 12.5, 12.5, 10.0])


# Scenes


def made(scenes: int = 2, agents: int = 7, seed: int = 0) -> SceneBatch:
    """Cars on three lanes along +x that change speed and drift aside, each in a way of its own."""
    random = torch.Generator().manual_seed(seed)

    def between(low: float, high: float, *shape: int) -> Tensor:
        return low + (high - low) * torch.rand(*shape, generator=random)

    shape = (scenes, agents)
    lane = torch.randint(0, 3, shape, generator=random)
    position = torch.stack([between(0.0, 50.0, *shape), 3.66 * lane + between(-0.3, 0.3, *shape)], dim=-1)
    speed, gain, drift = between(5.0, 15.0, *shape), between(-1.5, 1.5, *shape), between(-0.6, 0.6, *shape)

    def at(t: Tensor) -> Tensor:
        return torch.stack([speed[..., None] * t + 0.5 * gain[..., None] * t**2, drift[..., None] * t], dim=-1)

    past, ahead = DT * torch.arange(1 - HISTORY, 1), DT * torch.arange(1, HORIZON + 1)
    rates = torch.stack([torch.zeros(*shape, HISTORY), speed[..., None] + gain[..., None] * past], dim=-1)
    everybody = torch.ones(shape, dtype=torch.bool)
    future, known = at(ahead), everybody[..., None].expand(*shape, HORIZON)
    return SceneBatch(
        position=position,
        heading=between(-0.05, 0.05, *shape),
        history=torch.cat([at(past), rates], dim=-1),
        observed=everybody[..., None].repeat(1, 1, HISTORY),
        state=torch.stack([torch.full(shape, 4.5), torch.full(shape, 2.0), speed, torch.zeros(shape)], dim=-1),
        traffic=torch.zeros(*shape, TRAFFIC_CHANNELS),
        raster=torch.zeros(*shape, 1, 1, 1, dtype=torch.uint8),
        agent=everybody,
        future=future,
        future_known=known,
        maneuver=maneuvers_of(future, known, speed),
        target=everybody,
    )


def alone(*poses: tuple[float, float, float, float]) -> SceneBatch:
    """One scene of agents at x, y with a heading and a speed, that have always driven straight on."""
    x, y, heading, speed = torch.tensor(poses).T
    batch = made(1, len(poses))
    state = batch.state.clone()
    state[0, :, 2] = speed
    past = DT * torch.arange(1 - HISTORY, 1)
    zeros = torch.zeros(len(poses), HISTORY)
    history = torch.stack([speed[:, None] * past, zeros, zeros, speed[:, None].expand_as(zeros)], dim=-1)[None]
    position = torch.stack([x, y], dim=-1)[None]
    return replace(batch, position=position, heading=heading[None], state=state, history=history)


@pytest.fixture(scope="module")
def model() -> Bat:
    torch.manual_seed(1)
    return Bat(BatParameters()).eval()


def answers(model: Bat, batch: SceneBatch, decode: str | Tensor = "all") -> tuple[Tensor, ...]:
    with torch.no_grad():
        prediction = model(batch, decode)
    return prediction.maneuver, prediction.mean, prediction.scale, prediction.correlation


def seen(batch: SceneBatch, target: int, other: int) -> Tensor:
    motions = motions_of(batch)
    return polar(motions, torch.tensor([target]), torch.tensor([other]))[0]


def test_polar_coordinates_are_about_the_last_position_of_the_target() -> None:
    """The target looks along +y at 10 m/s; the other is 20 m to its left, and drives towards -x, away from it, at 5."""
    batch = alone((100.0, 50.0, torch.pi / 2, 10.0), (80.0, 50.0, torch.pi, 5.0))
    torch.testing.assert_close(seen(batch, 0, 1)[-1], torch.tensor([2.0, 0.0, 1.0, 0.5, -4.0, 2.0, 1.0]), **TOLERANCE)
    torch.testing.assert_close(seen(batch, 0, 1)[-6], torch.tensor([1.5, 0.0, 1.0, 0.5, -4.0, 2.0, 1.0]), **TOLERANCE)
    own = seen(batch, 0, 0)
    torch.testing.assert_close(own[0], torch.tensor([3.0, -1.0, 0.0, -1.0, 0.0, 0.0, 1.0]), **TOLERANCE)
    torch.testing.assert_close(own[-1], torch.tensor([0.0, 0.0, 0.0, -1.0, 0.0, 0.0, 1.0]), **TOLERANCE)
    # from the other's seat, the target passes from behind on the left to where the other's rear points
    torch.testing.assert_close(seen(batch, 1, 0)[-1], torch.tensor([2.0, -1.0, 0.0, 0.0, -2.0, -4.0, 1.0]), **TOLERANCE)


def test_what_was_not_observed_is_zero() -> None:
    batch = alone((0.0, 0.0, 0.0, 10.0), (10.0, 0.0, 0.0, 10.0))
    batch.observed[0, 1, :4] = False
    assert (seen(batch, 0, 1)[:4] == 0.0).all() and (seen(batch, 0, 1)[4:, -1] == 1.0).all()


def test_neighbours_are_those_on_the_grid_and_who_comes_close_ranks_first() -> None:
    edge = 13.5 * CELL_LENGTH
    batch = alone(
        (0.0, 0.0, 0.0, 10.0),
        (12.0, 0.0, 0.0, 10.0),  # keeps its distance
        (20.0, 0.0, 0.0, 2.0),  # will be run into
        (edge - 0.1, 1.4 * CELL_WIDTH, 0.0, 10.0),
        (edge + 0.1, 0.0, 0.0, 10.0),
        (0.0, -1.6 * CELL_WIDTH, 0.0, 10.0),
    )
    pairs = neighbours(batch)
    of_first = pairs.target == 0
    assert pairs.other[of_first].tolist() == [1, 2, 3]
    assert pairs.cell[of_first].tolist() == [3 * 16 + 1, 3 * 17 + 1, 3 * 26 + 2]
    assert pairs.rank[of_first].tolist() == [1, 0, 2]
    asked = neighbours(batch, torch.tensor([3, 0]))
    of_first = asked.target == 1
    assert asked.other[of_first].tolist() == [1, 2, 3] and asked.rank[of_first].tolist() == [1, 0, 2]


def test_the_model_is_of_the_size_of_the_papers(model: Bat) -> None:
    assert 250_000 < sum(p.numel() for p in model.parameters()) < 350_000


def test_where_on_the_earth_a_scene_is_does_not_matter(model: Bat) -> None:
    batch, angle = made(), torch.tensor(2.0)
    turn = torch.stack([angle.cos(), angle.sin(), -angle.sin(), angle.cos()]).view(2, 2)
    moved = replace(batch, position=batch.position @ turn + 300.0, heading=batch.heading + angle)
    for one, other in zip(answers(model, batch), answers(model, moved), strict=True):
        torch.testing.assert_close(one, other, rtol=1e-3, atol=2e-3)


@pytest.mark.parametrize("agents", [1, 7])
def test_who_was_seen_once_gets_a_finite_answer_and_gradients(agents: int) -> None:
    torch.manual_seed(1)
    model, batch = Bat(BatParameters()), made(2, agents)
    batch.observed[:, :, :-1] = False
    batch.history[:, :, :-1] = 0.0
    prediction = model(batch)
    loss = negative_log_likelihood(prediction, batch.future).mean() + prediction.maneuver.logsumexp(dim=-1).mean()
    loss.backward()
    assert all(torch.isfinite(values).all() for values in vars(prediction).values())
    assert all(p.grad is None or torch.isfinite(p.grad).all() for p in model.parameters())


def test_neighbours_and_their_behaviour_count(model: Bat) -> None:
    batch = made(1, 6)
    without = replace(batch, agent=batch.agent & (torch.arange(6) != 5))
    early = replace(batch, observed=batch.observed.clone())
    early.observed[0, 5, :8] = False
    whole = answers(model, batch)[1][:, :5]
    assert (answers(model, without)[1][:, :5] - whole).abs().amax() > 1e-4
    assert (answers(model, early)[1][:, :5] - whole).abs().amax() > 1e-5
