"""Data: support vectors, nonnegative least squares, an image between black and white."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse as sp

from lcp_plugin import QuadraticProgram

from . import Application, application
from .membranes import line


@application(small=dict(samples=80), full=dict(samples=500))
def support_vectors(samples: int) -> Application:
    """Two classes and a Gaussian kernel: 0 ≤ α ≤ C and one equation, its multiplier free; Cortes, Vapnik (1995)."""
    rng = np.random.default_rng(39)
    y = np.where(np.arange(samples) % 2, 1.0, -1.0)
    x = rng.normal(size=(samples, 2)) + 0.8 * y[:, None]
    distance = ((x[:, None] - x) ** 2).sum(-1)
    Q = y[:, None] * y * np.exp(-2.0 * distance)
    M = np.block([[Q, -y[:, None]], [y[None], np.zeros((1, 1))]])
    lower, upper = np.append(np.zeros(samples), -np.inf), np.append(np.ones(samples), np.inf)
    return Application(
        M,
        np.append(-np.ones(samples), 0.0),
        lower=lower,
        upper=upper,
        program=QuadraticProgram(Q, -np.ones(samples), A=y[None], b=[0.0], lower=0.0, upper=1.0),
    )


@application(small=dict(sources=40), full=dict(sources=300))
def nonnegative_least_squares(sources: int) -> Application:
    """A spectrum unmixed into overlapping peaks of nonnegative height, AᵀA; Lawson, Hanson (1974)."""
    rng = np.random.default_rng(40)
    t, centre = np.linspace(0.0, 1.0, 3 * sources), np.linspace(0.0, 1.0, sources)
    A = np.exp(-0.5 * ((t[:, None] - centre) * sources) ** 2)
    b = A @ np.maximum(rng.normal(size=sources), 0.0) + 0.05 * rng.normal(size=t.size)
    return Application(A.T @ A, -(A.T @ b))


@application(small=dict(side=16), full=dict(side=64))
def image_restoration(side: int) -> Application:
    """A blurred and noisy picture, smoothed, grey values from 0 to 1; Hansen, *Discrete Inverse Problems* (2010)."""
    rng = np.random.default_rng(41)
    offsets = np.arange(-2, 3)
    weights = np.exp(-0.5 * offsets**2) / np.exp(-0.5 * offsets**2).sum()
    blur = sp.diags_array(
        [np.full(side - abs(k), w) for k, w in zip(offsets, weights, strict=True)], offsets=offsets
    )
    K = sp.csr_array(sp.kron(blur, blur))
    smooth = sp.kron(line(side, 1.0), sp.eye_array(side)) + sp.kron(
        sp.eye_array(side), line(side, 1.0)
    )
    picture = np.kron(rng.integers(0, 2, size=(4, 4)), np.ones((side // 4, side // 4))).ravel()
    data: Any = K @ picture + 0.02 * rng.normal(size=side**2)
    return Application(sp.csr_array(K.T @ K + 1e-3 * smooth), -(K.T @ data), upper=1.0)
