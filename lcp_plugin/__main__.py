"""``python -m lcp_plugin`` is the command ``lcp-plugin``."""

from .cli import run

run()
