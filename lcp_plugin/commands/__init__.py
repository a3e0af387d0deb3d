"""The command lines `lcp-plugin` (:mod:`.cli`) and `lcp-plugin-ampl` (:mod:`.ampl`)."""
