"""One subpackage per problem class or task: data, conversion, kernels, certificate, result."""
