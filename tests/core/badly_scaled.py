"""A problem of five unknowns in units from 10^-4 to 10^6, for which one size of z hides errors."""

from __future__ import annotations

from typing import Any

import numpy as np

#: M and q of a problem whose unknowns have the units 10^3, 10^5, 10^-4, 10^-4 and 10^6, and its answer.
M = np.array([
    [2.35318523e-03, 6.06984072e-06, -2.54587569e+04, 2.33554286e+04, 1.61755744e-07],
    [-1.55515318e-03, 7.64879354e-06, -1.31653789e+04, 8.79399008e+03, 1.63152359e-06],
    [3.25596614e-03, 9.56071604e-06, 7.66435289e+03, -1.86893807e+03, 5.22911483e-08],
    [-1.92052271e-03, -8.79399008e-06, 2.03134531e+03, 5.69671812e+03, 6.12283592e-07],
    [-1.87347584e-03, -1.63152359e-05, -7.69858937e+03, -7.52937308e+03, 2.61134328e-06],
])  # fmt: skip
Q = np.array([-5.96137683, -2.3919863, -5.55386248, 0.7711112, 2.47934087])
BOUNDS: Any = {
    "lower": [0.0, -1e5, 0.0, -1e-4, -np.inf],
    "upper": [np.inf, 0.0, np.inf, 1e-4, np.inf],
}
ANSWER = np.array([1707.59939, 0.0, 1.93616553e-05, 1e-4, 621059.702])
