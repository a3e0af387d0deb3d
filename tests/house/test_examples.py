"""Every example runs without a warning, saves its figure, and agrees with its reference."""

from __future__ import annotations

import re
import runpy
import sys
import warnings
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).parents[2] / "examples"
NUMBER = r"([\d.]+(?:e[+-]\d+)?%?)"

# Each example prints a line "check: …": a pattern for its number, and the largest valid value.
CHECKS = [
    ("two_by_two_in_cvxpy", f"all four cases by hand differ by {NUMBER}", 1e-9),
    ("obstacle_problem", f"the heights differ from the closed form by {NUMBER}", 1e-3),
    (
        "obstacle_with_scikit_fem",
        f"the heights differ from the closed form by {NUMBER} in L²",
        1e-5,
    ),
    ("obstacle_with_scikit_fem", f"off 2 and 2.5 by {NUMBER}", 0.1),
    ("american_put", f"the prices differ from a binomial tree by at most {NUMBER} EUR", 0.02),
    ("journal_bearing", f"the largest pressure differs from quadrature by {NUMBER}", 0.002),
    ("journal_bearing", f"the place where the film tears by {NUMBER}", 0.1),
    (
        "spatial_price_equilibrium",
        f"the prices of the greatest surplus differ by {NUMBER} EUR/t",
        1e-4,
    ),
    ("bimatrix_game", f"7 equilibria here, 7 by supports; the same up to {NUMBER}", 1e-12),
    (
        "stack_of_blocks",
        f"the forces of the standing tower differ from the lever rule by {NUMBER} N",
        1e-9,
    ),
    ("nnls_svm_portfolio", f"least squares differ from scipy's nnls by {NUMBER}", 1e-9),
    ("nnls_svm_portfolio", f"the classifier's duality gap is {NUMBER}", 1e-9),
    (
        "nnls_svm_portfolio",
        f"the portfolios differ from the portfolios of a conic solver by {NUMBER}",
        1e-4,
    ),
    (
        "denoise_picture",
        rf"the energy [\d.]+ is at most {NUMBER} above the least, relatively",
        1e-5,
    ),
    (
        "error_against_time",
        rf"with the same [1-9]\d* hottest points a linear solve differs by {NUMBER}",
        1e-8,
    ),
    ("paper_accelerated", f"the same free unknowns differ by {NUMBER}", 1e-5),
    ("paper_study", f"a loop in NumPy takes as many sweeps up to {NUMBER}", 1.0),
    ("paper_tables", f"the number of iterations differs in {NUMBER} of 48 cells", 0.0),
    (
        "add_an_algorithm",
        f"the largest error on random problems with exact answers is {NUMBER}",
        1e-6,
    ),
    ("model_predictive_control", f"plans differ from a conic solver's by {NUMBER} m/s²", 1e-4),
    (
        "model_predictive_control",
        f"where no limit acts, inputs differ from −K x by {NUMBER} m/s²",
        1e-12,
    ),
    ("parameter_study", f"the first torque differs from the elastic one by {NUMBER}, ", 0.005),
    ("parameter_study", f"the last from the fully plastic one by {NUMBER}", 0.01),
    ("lasso_path", f"twenty solves differ from the path by at most {NUMBER}, ", 1e-6),
    ("lasso_path", f"and cvxpy's by {NUMBER}", 1e-7),
    ("efficient_frontier", f"the shares of the critical line differ by {NUMBER} at", 1e-9),
    ("option_greeks", f"delta differs from the tree's by {NUMBER}, ", 1e-4),
    ("option_greeks", f"vega by {NUMBER}, ", 1e-4),
    ("option_greeks", f"rho by {NUMBER}, relatively", 1e-4),
    ("option_greeks", f"backwards they are the same at the money to {NUMBER}", 1e-8),
    ("calibration", f"all quotes are met to {NUMBER}, relatively", 1e-8),
    ("calibration", f"differ from the known ones by at most {NUMBER} percentage points", 0.1),
    (
        "calibration",
        f"vega differs from a central difference by at most {NUMBER}, relatively",
        2e-3,
    ),
    (
        "designed_contact",
        f"in a random direction the gradient differs from a difference by {NUMBER}, ",
        1e-6,
    ),
    (
        "learn_friction",
        f"without noise the coefficients differ from the known ones by {NUMBER}, ",
        1e-9,
    ),
    ("learn_friction", f"10 mm of noise by {NUMBER}", 0.01),
    ("general_equilibrium", f"markets differ from cleared ones by {NUMBER} units", 1e-3),
    ("cournot_oligopoly", f"the published outputs differ by {NUMBER}", 1e-4),
    ("cournot_oligopoly", f"alone no firm could earn more than {NUMBER} besides", 1e-6),
    (
        "elastic_transport",
        f"sales differ from those of the greatest surplus by {NUMBER} cases",
        0.02,
    ),
    ("self_heating", f"which differs from the integral by {NUMBER}", 1e-4),
    ("network_tolls", f"the income of an integer program differs by {NUMBER};", 1e-4),
    ("network_tolls", f"tolls lower by a millionth earn less by {NUMBER}, relatively", 1e-5),
    ("carbon_price", f"no price of the grid is better by more than {NUMBER}", 1e-6),
    ("monopolist_over_fringe", f"the income differs from the formula's 12.5 by {NUMBER}", 1e-6),
    ("yes_or_no_investment", f"welfare differs from the best of all sixteen by {NUMBER}", 1e-6),
    ("cheapest_bolts", f"the same lift up to {NUMBER} mm", 1e-8),
    ("cheapest_bolts", f"the cost of an integer program differs by {NUMBER}", 1e-5),
    ("block_on_incline", f"the speeds differ from the closed form by {NUMBER} m/s", 1e-9),
    ("sliding_along_gravity", f"with the cone it slides at most {NUMBER}° aside", 1e-6),
    ("spinning_disc", rf"v / \(R ω\) differs from 0.653 by {NUMBER}", 0.03),
    ("tower_of_ten", f"the weights above them by {NUMBER} N, ", 1e-9),
    ("tower_of_ten", f"the speeds from the closed form by {NUMBER} m/s", 1e-9),
    ("poured_discs", f"floor and walls carry the weight up to {NUMBER}, ", 1e-6),
    ("poured_discs", f"discs overlap by {NUMBER} of their radius", 1e-6),
]
NAMES = list(dict.fromkeys(name for name, *_ in CHECKS))


def run(name: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Run an example as a script, every warning an error."""
    import matplotlib.pyplot as plt

    plt.switch_backend("agg")
    monkeypatch.setattr("sys.path", [*sys.path])
    monkeypatch.setattr("sys.argv", [f"{name}.py", "--out", str(folder)])
    with plt.rc_context(), warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(SystemExit) as ended:
            runpy.run_path(str(EXAMPLES / f"{name}.py"), run_name="__main__")
    assert not ended.value.code


@pytest.mark.full
@pytest.mark.parametrize("name", NAMES)
def test_example_keeps_its_promise(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """An example ends normally, saves only one figure, and its printed comparison is close."""
    run(name, tmp_path, monkeypatch)
    printed = capsys.readouterr().out
    for _, pattern, largest in (check for check in CHECKS if check[0] == name):
        found = re.search(f"^check: .*?{pattern}", printed, re.M)
        assert found, printed
        value = float(found[1].rstrip("%")) / (100 if found[1].endswith("%") else 1)
        assert value <= largest, printed
    assert [file.name for file in tmp_path.iterdir()] == [f"{name}.png"]
    picture = (tmp_path / f"{name}.png").read_bytes()
    assert picture.startswith(b"\x89PNG")
    assert len(picture) > 20_000


@pytest.mark.full
def test_the_command_draws_the_picture_of_the_readme(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The script solves the three problems, and its figure has the size of README's figure."""
    readme = EXAMPLES.parent.joinpath("README.md").read_text(encoding="utf-8")
    assert "(examples/pictures/three_problems.png)" in readme
    assert "`python examples/pictures/three_problems.py`" in readme
    run("pictures/three_problems", tmp_path, monkeypatch)
    drawn, shown = (
        folder.joinpath("three_problems.png").read_bytes()
        for folder in (tmp_path, EXAMPLES / "pictures")
    )
    assert drawn[16:24] == shown[16:24]  # width and height in pixels


def test_every_example_is_tested_and_in_the_readme() -> None:
    """The directory, the table above and the README list the same examples, in the same order."""
    readme = EXAMPLES.joinpath("README.md").read_text(encoding="utf-8")
    assert sorted(file.stem for file in EXAMPLES.glob("*.py")) == sorted(NAMES)
    assert re.findall(r"^\| `(\w+)\.py`", readme, re.M) == NAMES
