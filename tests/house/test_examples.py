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

# Each example prints a line "check: …": example, pattern with # for its number, and the largest valid value.
TABLE = r"""
two_by_two_in_cvxpy | all four cases by hand differ by # | 1e-09
obstacle_problem | the heights differ from the closed form by # | 0.001
obstacle_with_scikit_fem | the heights differ from the closed form by # in L² | 1e-05
obstacle_with_scikit_fem | off 2 and 2.5 by # | 0.1
american_put | the prices differ from a binomial tree by at most # EUR | 0.02
journal_bearing | the largest pressure differs from quadrature by # | 0.002
journal_bearing | the place where the film tears by # | 0.1
spatial_price_equilibrium | the prices of the greatest surplus differ by # EUR/t | 0.0001
bimatrix_game | 7 equilibria here, 7 by supports; the same up to # | 1e-12
stack_of_blocks | the forces of the standing tower differ from the lever rule by # N | 1e-09
nnls_svm_portfolio | least squares differ from scipy's nnls by # | 1e-09
nnls_svm_portfolio | the classifier's duality gap is # | 1e-09
nnls_svm_portfolio | the portfolios differ from the portfolios of a conic solver by # | 0.0001
denoise_picture | the energy [\d.]+ is at most # above the least, relatively | 1e-05
error_against_time | with the same [1-9]\d* hottest points a linear solve differs by # | 1e-08
paper_accelerated | the same free unknowns differ by # | 1e-05
paper_study | a loop in NumPy takes as many sweeps up to # | 1
paper_tables | the number of iterations differs in # of 48 cells | 0
stability_atlas | warning of numpy ended # of | 0
add_an_algorithm | the largest error on random problems with exact answers is # | 1e-06
model_predictive_control | plans differ from a conic solver's by # m/s² | 0.0001
model_predictive_control | where no limit acts, inputs differ from −K x by # m/s² | 1e-12
parameter_study | the first torque differs from the elastic one by #,  | 0.005
parameter_study | the last from the fully plastic one by # | 0.01
lasso_path | twenty solves differ from the path by at most #,  | 1e-06
lasso_path | and cvxpy's by # | 1e-07
efficient_frontier | the shares of the critical line differ by # at | 1e-09
option_greeks | delta differs from the tree's by #,  | 0.0001
option_greeks | vega by #,  | 0.0001
option_greeks | rho by #, relatively | 0.0001
option_greeks | backwards they are the same at the money to # | 1e-08
heston | published prices differ by at most # | 0.002
calibration | all quotes are met to #, relatively | 1e-08
calibration | differ from the known ones by at most # percentage points | 0.1
calibration | vega differs from a central difference by at most #, relatively | 0.002
designed_contact | in a random direction the gradient differs from a difference by #,  | 1e-06
learn_friction | without noise the coefficients differ from the known ones by #,  | 1e-09
learn_friction | 10 mm of noise by # | 0.01
general_equilibrium | markets differ from cleared ones by # units | 0.001
cournot_oligopoly | the published outputs differ by # | 0.0001
cournot_oligopoly | alone no firm could earn more than # besides | 1e-06
permit_market | prices differ from Clarabel's by # EUR | 1e-04
permit_market | their slopes at 3 t differ from differences of Clarabel by # EUR/t | 1e-06
elastic_transport | sales differ from those of the greatest surplus by # cases | 0.02
self_heating | which differs from the integral by # | 0.0001
network_tolls | the income of an integer program differs by #; | 0.0001
network_tolls | tolls lower by a millionth earn less by #, relatively | 1e-05
carbon_price | no price of the grid is better by more than # | 1e-06
two_leaders | the taxes by hand by # | 0.001
two_leaders | no region gains more than #, as proved | 1e-07
monopolist_over_fringe | the income differs from the formula's 12.5 by # | 1e-06
yes_or_no_investment | welfare differs from the best of all sixteen by # | 1e-06
cheapest_bolts | the same lift up to # mm | 1e-08
cheapest_bolts | the cost of an integer program differs by # | 1e-05
block_on_incline | the speeds differ from the closed form by # m/s | 1e-09
sliding_along_gravity | with the cone it slides at most #° aside | 1e-06
spinning_disc | v / \(R ω\) differs from 0.653 by # | 0.03
tower_of_ten | the weights above them by # N,  | 1e-09
tower_of_ten | the speeds from the closed form by # m/s | 1e-09
poured_discs | floor and walls carry the weight up to #,  | 1e-06
poured_discs | discs overlap by # of their radius | 1e-06
"""
ROWS = [line.split(" | ") for line in TABLE.strip().splitlines()]
CHECKS = [(name, text.replace("#", NUMBER), float(most)) for name, text, most in ROWS]
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
def test_example_keeps_its_promise(name, tmp_path, monkeypatch, capsys):
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
def test_the_command_draws_the_picture_of_the_readme(tmp_path, monkeypatch):
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


def test_every_example_is_tested_and_in_the_readme():
    """The directory, the table above and the README list the same examples, in the same order."""
    readme = EXAMPLES.joinpath("README.md").read_text(encoding="utf-8")
    assert sorted(file.stem for file in EXAMPLES.glob("*.py")) == sorted(
        [*NAMES, "check_proof", "mujoco_step"]
    )
    assert re.findall(r"^\| `(\w+)\.py`", readme, re.M) == NAMES
