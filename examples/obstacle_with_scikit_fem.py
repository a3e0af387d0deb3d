"""A membrane over a ball on an unstructured mesh, assembled by scikit-fem: linear and quadratic elements.

An assembler of finite elements yields M and q; five lines then solve the obstacle problem and certify the solution
(`membrane`). The membrane is fixed along a circle of radius 2 and lies over a ball of radius 1. For this edge its
height is known: u = −A log(r/2) outside the radius r* with r*² (1 − log(r*/2)) = 1; at r* its curvature jumps.

With linear elements on a Delaunay mesh no two nodes inside have a positive entry, so that M is an M-matrix, which its
signs and one vector prove at any size: sweeps are proved to converge. With quadratic elements there are positive
entries, and no theorem on sweeps applies; M is still positive definite, which takes a factorization to prove. The
residual that judges the answer is the same, and of both the error of z has a proved bound. The error in L² falls like
h² with linear elements, and with quadratic ones like h^2.5, not h³, because of the jump.

Sources: Kinderlehrer, Stampacchia, An Introduction to Variational Inequalities and Their Applications, SIAM 2000,
doi:10.1137/1.9780898719451; Gustafsson, McBain, scikit-fem, JOSS 5 (2020), doi:10.21105/joss.02369.
"""

from itertools import product
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import typer
from scipy.optimize import brentq
from scipy.spatial import Delaunay
from skfem import Basis, ElementTriP1, ElementTriP2, MeshTri, MeshTri2
from skfem.models.poisson import laplace, mass

from lcp_plugin import LCP, analyze, error_bound, solve

EDGE = 2.0  # the radius of the circle
NODES = (250, 1000, 4000, 16000)  # inside of it, about
PICTURED = NODES[1]
ELEMENTS = ("linear", "quadratic")
EXPECTED = np.array([2.0, 2.5])
CONTACT = brentq(lambda radius: radius**2 * (1 - np.log(radius / EDGE)) - 1, 0.1, 0.9)


def membrane(basis: Basis):
    """Return the height at all nodes, and the result of the solve."""
    inside = basis.complement_dofs(basis.get_dofs())
    M = laplace.assemble(basis)[inside][:, inside]
    result = solve(LCP(M, np.zeros(inside.size), lower=ball(radii(basis)[inside]))).require_solved()
    u = basis.zeros()
    u[inside] = result.z
    return u, result


def radii(basis: Basis) -> np.ndarray:
    """Return the distance of each node from the centre."""
    return np.hypot(*basis.doflocs)


def ball(r: np.ndarray) -> np.ndarray:
    """Return the height of the ball where the membrane may touch it, and less elsewhere."""
    return np.where(r < 0.9, np.sqrt(1 - np.minimum(r, 0.9) ** 2), -1.0)


def exact(r: np.ndarray) -> np.ndarray:
    """Return the height of the membrane."""
    strength = CONTACT**2 / np.sqrt(1 - CONTACT**2)
    return np.where(r < CONTACT, ball(r), -strength * np.log(np.maximum(r, CONTACT) / EDGE))


def disk(count: int) -> MeshTri:
    """Return a Delaunay mesh with nodes as the seeds of a sunflower lie, and others along the edge."""
    seed, width = np.arange(count), EDGE * np.sqrt(np.pi / count)
    r, angle = EDGE * np.sqrt((seed + 0.5) / count), seed * np.pi * (3 - np.sqrt(5))
    r, angle = r[r < EDGE - 0.6 * width], angle[r < EDGE - 0.6 * width]
    along = np.arange(0, 2 * np.pi - width / EDGE / 2, width / EDGE)
    points = np.array([np.append(r * one(angle), EDGE * one(along)) for one in (np.cos, np.sin)])
    return MeshTri(points, Delaunay(points.T).simplices.T.copy())


def curved(mesh: MeshTri) -> MeshTri2:
    """Return the mesh with the outer sides of its triangles bent onto the circle, as quadratic elements need them."""
    bent = MeshTri2.from_mesh(mesh)
    places, middles = bent.doflocs.copy(), mesh.p.shape[1] + mesh.boundary_facets()
    places[:, middles] *= EDGE / np.hypot(*places[:, middles])
    return MeshTri2(places, bent.t)


def main(out: Path = Path()) -> None:
    """Solve on finer and finer meshes, compare with the closed form, and save a figure into the folder OUT."""
    errors = np.empty((len(ELEMENTS), len(NODES)))
    for (row, name), (column, count) in product(enumerate(ELEMENTS), enumerate(NODES)):
        mesh = disk(count)
        basis = (
            Basis(mesh, ElementTriP1()) if name == "linear" else Basis(curved(mesh), ElementTriP2())
        )
        u, result = membrane(basis)
        off = u - exact(radii(basis))
        errors[row, column] = np.sqrt(off @ mass.assemble(basis) @ off)
        if count == PICTURED:
            problem, touches = result.certificate.problem, radii(basis)[u == ball(radii(basis))]
            print(
                f"{name}: n = {problem.n}, {result.status.name} by {result.algorithm}\n  it touches at "
                f"{touches.size} nodes up to the radius {touches.max():.4f} (r* = {CONTACT:.4f}); H₊-matrix: "
                f"{analyze(problem).is_h_plus}\n  {error_bound(problem, result.z)}"
            )
    widths = np.sqrt(np.pi / np.array(NODES)) * EDGE
    orders = [np.polyfit(np.log(widths), np.log(row), 1)[0] for row in errors]
    print(
        f"check: the heights differ from the closed form by {errors[1, -1]:.1e} in L²; that falls like "
        f"{' and '.join(f'h^{order:.2f}' for order in orders)}, off 2 and 2.5 by {abs(orders - EXPECTED).max():.2f}"
    )
    draw(out, widths, errors, orders)


def draw(out: Path, widths: np.ndarray, errors: np.ndarray, orders: list[float]) -> None:
    """Save the figure."""
    mesh = disk(PICTURED)
    u, _ = membrane(Basis(mesh, ElementTriP1()))
    plt.style.use(Path(__file__).with_name("plots.mplstyle"))
    figure, (left, right) = plt.subplots(
        1, 2, figsize=(9.4, 4.3), layout="constrained", width_ratios=[1.15, 1]
    )
    image = left.tripcolor(*mesh.p, mesh.t.T, u, shading="gouraud", cmap="cividis")
    left.triplot(*mesh.p, mesh.t.T, color="white", linewidth=0.25)
    touches = u == ball(np.hypot(*mesh.p))
    left.plot(*mesh.p[:, touches], ".", color="#D55E00", markersize=3.5)
    angle = np.linspace(0, 2 * np.pi, 200)
    left.plot(CONTACT * np.cos(angle), CONTACT * np.sin(angle), color="#D55E00", linewidth=1)
    figure.colorbar(image, ax=left, shrink=0.85).outline.set_visible(False)
    left.set(aspect="equal", title="Height; dots: where it touches, circle: r*")
    left.set_axis_off()
    for name, color, error, order in zip(
        ELEMENTS, ("#0072B2", "#009E73"), errors, orders, strict=True
    ):
        right.loglog(widths, error, "o-", color=color, linewidth=1.5)
        right.annotate(
            f"{name} elements: h^{order:.2f}",
            (widths[-1], error[-1]),
            (16, -6),
            textcoords="offset points",
            color=color,
        )
    right.set(title="Error in L² against the mesh width h", xlabel="h", xticks=widths)
    right.set_xticklabels([f"{width:.2f}" for width in widths])
    right.minorticks_off()
    figure.savefig(out / "obstacle_with_scikit_fem.png", dpi=150)


if __name__ == "__main__":
    typer.run(main)
