"""Kinds of problems and of questions, a subpackage each: data, conversion, kernels, certificate, result."""
