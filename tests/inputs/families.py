"""The registered algorithms by what they are, so that a claim is tested on all to which it applies."""

from lcp_plugin.algorithms import REGISTRY, algorithm_class

KINDS = {name: algorithm_class(name) for name in REGISTRY}
SWEEPERS = [name for name, kind in KINDS.items() if "sweep" in kind.__dataclass_fields__]
DIRECT = [name for name, kind in KINDS.items() if not kind.is_monotone]  # end by themselves
MODULUS = [name for name in SWEEPERS if "omega" in KINDS[name].__dataclass_fields__]
BOUNDED = [name for name in REGISTRY if name not in MODULUS]  # take upper bounds and free rows
