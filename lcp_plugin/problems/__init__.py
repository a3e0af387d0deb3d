"""Kinds of problems and of questions, a room each: data, conversion, kernels, certificate, result."""
