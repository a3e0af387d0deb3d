"""Problems that depend on one parameter: the path of the solution.

The solution z(θ) of a linear complementarity problem is piecewise affine if q and the bounds are affine in θ. The x
and the multipliers of a quadratic program, and the x of a least squares problem with a penalty, are also piecewise
affine. The solution of a nonlinear problem is piecewise smooth.

| file | content |
|---|---|
| `tracing` | :func:`lcp_plugin.trace`; per problem class: data that may move, complementarity problem, point |
| `path` | the returned :class:`Path`, its pieces and points |
| `following` | complementarity problem with data affine in θ; path following from breakpoint to breakpoint |
| `smooth` | path following of a nonlinear problem, by predictions and Newton's method |
"""
