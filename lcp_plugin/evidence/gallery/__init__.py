"""Named, parametrised scenes: problems that know what is known about them.

``build("obstacle_2d", size=200)``, ``obstacle_2d(size=200)`` and ``parse("obstacle_2d:size=200")`` give the
same :class:`Scene`; ``describe()`` lists them all. Write ``from lcp_plugin import gallery`` and ``gallery.Scene``:
``lcp_plugin.gallery`` is a name of the front door, not a module.
"""

from .bearing import journal_bearing
from .binomial_tree import binomial_put
from .circuits import diode_bridge, relay_control
from .contact import rigid_stack
from .diffusion import coefficient_jumps, convection_diffusion, rotated_anisotropy
from .equilibria import market_equilibrium
from .games import bimatrix_game
from .matrices import murty, random_h_plus, scaling_trap
from .obstacle import obstacle_2d, obstacle_3d, obstacle_bumps
from .option_pricing import american_put, american_put_march
from .paper import half_active, paper_example_1, paper_example_2
from .registry import Description, build, describe, names, parse, scene_builder
from .scene import Scene
from .stopping import optimal_stopping
from .torsion import elastic_plastic_torsion

__all__ = [
    "Description",
    "Scene",
    "american_put",
    "american_put_march",
    "bimatrix_game",
    "binomial_put",
    "build",
    "coefficient_jumps",
    "convection_diffusion",
    "describe",
    "diode_bridge",
    "elastic_plastic_torsion",
    "half_active",
    "journal_bearing",
    "market_equilibrium",
    "murty",
    "names",
    "obstacle_2d",
    "obstacle_3d",
    "obstacle_bumps",
    "optimal_stopping",
    "paper_example_1",
    "paper_example_2",
    "parse",
    "random_h_plus",
    "relay_control",
    "rigid_stack",
    "rotated_anisotropy",
    "scaling_trap",
    "scene_builder",
]
