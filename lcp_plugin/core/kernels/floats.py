"""Constants of double precision, and margins for rounding errors."""

from __future__ import annotations

EPSILON = 2.0**-52  # from 1 to the next double
UNIT = 2.0**-53  # the largest relative error of one rounding
TINY = 2.0**-1074  # the smallest positive double; a product that underflows is wrong by up to this
NORMAL = 2.0**-1022  # the smallest normal double: below it the next one is TINY away
LARGEST = 1.7976931348623157e308  # the largest double
DATA_ROUNDING = 2.0**-44  # as many roundings as a time step or an assembly adds up, with a margin
OUTWARD = (
    1.0 + 2.0**-30
)  # above the rounding of a sum of up to 2²² terms of one sign, and of a few products
UNDERFLOW = 1e-290  # far more than all that underflows in a sum of products of numbers of size 1
NEGLIGIBLE = 2.0**-42  # relative to the active terms at a solution: smaller terms are ignored
# of the largest entry of its row: a smaller one is not the row's scale
NEGLIGIBLE_DIAGONAL = 2.0**-20
SMALLEST_PIVOT = 1e-11  # of Lemke's path on a small problem, of rows divided by their largest entry
PERTURBED = 2.0**-36  # of the largest q: no two rows block at once
# smaller values of z relative to 1 or the largest are 0: their products underflow
SMALLEST = 1e-130
LOW, FREE, HIGH = 0, 1, 2  # side of z_i: at its lower bound, between the bounds, at its upper bound
