"""The stability atlas: every algorithm under every stress, each run judged against the exact answer."""

from .atlas import Atlas, Cell, stability_atlas

__all__ = ["Atlas", "Cell", "stability_atlas"]
