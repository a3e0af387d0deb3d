"""Constants of double precision, and margins above its errors, each with its derivation.

A rounding is wrong by UNIT of its result, a sum of k terms of one sign by less than k UNIT, and a product that
underflows by TINY.
"""

from __future__ import annotations

EPSILON = 2.0**-52  # from 1 to the next double
FEW_ROUNDINGS = 4.0 * EPSILON  # relative: of a few operations in a row
UNIT = 2.0**-53  # the largest relative error of one rounding
TINY = 2.0**-1074  # the smallest positive double; a product that underflows is wrong by up to this
NORMAL = 2.0**-1022  # the smallest normal double: below it the next double is TINY away
INF = float("inf")
LARGEST = 1.7976931348623157e308  # the largest double
# 2⁸ EPSILON: as many roundings as a time step or an assembly adds up, with a margin
DATA_ROUNDING = 2.0**-44
# above the error of a sum of 2²² terms of one sign, 2²² UNIT = 2⁻³¹ of it, and of a few products
OUTWARD = 1.0 + 2.0**-30
UNDERFLOW = 1e-290  # far more than all that underflows in a sum of products of numbers of size 1
# the rounding error of a larger product has bits down to 2⁻¹⁰⁶⁶, so it is a double
MAY_UNDERFLOW = 2.0**-960
NEGLIGIBLE = 2.0**-42  # relative to the active terms at a solution: smaller terms are ignored
# of the largest entry of its row: a smaller entry is not the row's scale
NEGLIGIBLE_DIAGONAL = 2.0**-20
HALF_OF_DIGITS = 2.0**-26  # relative: a smaller change, slack or Newton step is not seen
SMALLEST_PIVOT = 1e-11  # of Lemke's path on a small problem, of rows divided by their largest entry
PERTURBED = 2.0**-36  # of the largest q: no two rows block at once
# smaller values of z relative to 1 or the largest are 0: their products underflow
SMALLEST = 1e-130
LOW, FREE, HIGH = 0, 1, 2  # side of z_i: at its lower bound, between the bounds, at its upper bound
