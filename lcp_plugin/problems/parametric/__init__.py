"""Problems that depend on one parameter: the exact path of the solution.

z(θ) of a linear complementarity problem whose q and bounds are affine in θ is piecewise affine. So are x and the
multipliers of a quadratic program, and x of a least squares problem with a penalty.

| file | what is in it |
|---|---|
| `tracing` | :func:`lcp_plugin.trace` |
| `path` | what it returns |
| `families` | which data of a kind may move, its complementarity problem at θ, and the way back |
| `staircases` | that problem, rows with a kink included, affine in θ |
| `following` | from breakpoint to breakpoint |
"""
