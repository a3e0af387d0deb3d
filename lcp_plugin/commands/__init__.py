"""What the subcommands of `lcp-plugin` do; `cli` says what they are called."""
