"""Problems that depend on one parameter: the exact path of the solution.

The solution z(θ) of a linear complementarity problem is piecewise affine if q and the bounds are affine in θ. The x
and the multipliers of a quadratic program, and the x of a least squares problem with a penalty, are also piecewise
affine.

| file | content |
|---|---|
| `tracing` | :func:`lcp_plugin.trace` |
| `path` | the returned :class:`Path` |
| `families` | per problem class: data that may move, complementarity problem at θ, inverse mapping |
| `monotone_graphs` | complementarity problem with data affine in θ; rows may have a kink |
| `following` | path following from breakpoint to breakpoint |
"""
