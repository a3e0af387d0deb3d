"""``python -m lcp_plugin`` is the command ``lcp-plugin``."""

from .commands.cli import run

if __name__ == "__main__":
    run()
