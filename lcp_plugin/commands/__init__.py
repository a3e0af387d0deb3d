"""Functions behind the subcommands of `lcp-plugin`, which :mod:`.cli` declares."""
