"""Layers of networks by compiled loops, against plain numpy in double precision."""

import numpy as np
import pytest

from litsim_predictor.inference.dense_kernels import (
    add_and_normalise,
    add_product,
    exp,
    linear,
    rectified_linear,
    rectify,
    tanh,
)


def draw(*shape: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=shape).astype(np.float32)


@pytest.mark.parametrize(("rows", "inner", "columns"), [(1, 1, 1), (4, 4, 16), (7, 5, 20), (13, 33, 9), (65, 160, 96)])
def test_products_of_any_size(rows: int, inner: int, columns: int) -> None:
    values, weight, bias = draw(rows, inner), draw(inner, columns, seed=1), draw(columns, seed=2)
    out = np.empty((rows, columns), np.float32)
    linear(values, weight, bias, out)
    product = values.astype(np.float64) @ weight.astype(np.float64)
    np.testing.assert_allclose(out, product + bias, atol=1e-4)
    add_product(values, weight, out)
    np.testing.assert_allclose(out, 2.0 * product + bias, atol=2e-4)
    expected = np.maximum(out, 0.0)
    rectify(out)
    assert np.array_equal(out, expected)
    rectified_linear(values, weight, bias, out)
    np.testing.assert_allclose(out, np.maximum(product + bias, 0.0), atol=1e-4)


@pytest.mark.parametrize("rows", [1, 3, 4, 9])
@pytest.mark.parametrize("columns", [1, 7, 8, 16, 24, 32, 48, 61, 96])
def test_terms_are_multiplied_and_added_at_once_one_after_the_other(rows: int, columns: int) -> None:
    values, weight, out = draw(rows, 37), draw(37, columns, seed=1), draw(rows, columns, seed=2)
    expected, exact = out.copy(), np.longdouble  # which is exact for one product, and rounded once with its sum
    for k in range(37):
        expected = (expected + values[:, k : k + 1].astype(exact) * weight[k].astype(exact)).astype(np.float32)
    add_product(values, weight, out)
    assert np.array_equal(out, expected)


def test_functions_are_as_close_as_single_precision_allows() -> None:
    x = np.linspace(-30.0, 30.0, 20001, dtype=np.float32)
    exact = x.astype(np.float64)
    assert np.abs(np.array([tanh(v) for v in x]) - np.tanh(exact)).max() < 5e-7
    below = x <= 0.0
    assert np.abs(np.array([exp(v) for v in x[below]]) - np.exp(exact[below])).max() < 5e-7
    assert exp(np.float32(0.0)) == 1.0


def test_rows_are_normalised() -> None:
    values, more, gain, bias = draw(5, 160), draw(5, 160, seed=1), draw(160, seed=2), draw(160, seed=3)
    out = np.empty_like(values)
    add_and_normalise(values, more, gain, bias, out)
    total = values.astype(np.float64) + more
    expected = (total - total.mean(axis=1, keepdims=True)) / np.sqrt(total.var(axis=1, keepdims=True) + 1e-5)
    np.testing.assert_allclose(out, expected * gain + bias, atol=1e-5)
