"""Faults around a run: they are reported, corrupt nothing, and later results have the same bits."""

from __future__ import annotations

import os
import subprocess
import sys
import textwrap
from pathlib import Path
from shutil import copytree, ignore_patterns

import numpy as np
import pytest
from inputs import membranes

from lcp_plugin import Status, gallery, solve
from lcp_plugin.algorithms import NPSOR, Step

SWEPT = gallery.build("obstacle_2d", size=30).problem  # auto begins with npsor
PACKAGE = Path(__file__).parents[2] / "lcp_plugin"


def in_a_process(code: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """Run a program with warnings as errors and one thread."""
    settings = {"OMP_NUM_THREADS": "1", "PYTHONPATH": str(PACKAGE.parent), **environment}
    return subprocess.run(
        [sys.executable, "-P", "-W", "error", "-c", textwrap.dedent(code)],
        capture_output=True, text=True, check=False, timeout=120, env={**os.environ, **settings},
    )  # fmt: skip


# --- Ctrl-C ---------------------------------------------------------------------------------------------------------

INTERRUPTIONS = """
    import signal, sys
    import numpy as np
    from lcp_plugin import LCP, Status, solve
    from lcp_plugin import gallery
    scene = gallery.build("obstacle_2d", size=25, shifted=True).problem
    problem = LCP(scene.csr, scene.q, lower=scene.lower)
    names, rng = sys.argv[1:], np.random.default_rng(0)
    signal.signal(signal.SIGALRM, signal.default_int_handler)
    def outcome(name, seconds):
        try:
            signal.setitimer(signal.ITIMER_REAL, seconds)
            result = solve(problem, name)
            signal.setitimer(signal.ITIMER_REAL, 0.0)
        except KeyboardInterrupt:
            return "before or after the run"
        assert result.status in (Status.INTERRUPTED, Status.SOLVED), result.status
        assert np.isfinite(result.z).all() and (result.z >= problem.lower).all()
        assert result.is_solved == (result.residual <= result.tolerance)
        return result.status.name
    for name in names:
        solve(problem, name)
        whole, around = solve(problem, name), np.geterr()
        assert whole.is_solved, name
        told = []
        for _ in range(15):
            told.append(outcome(name, float(rng.uniform(1e-6, 1.1 * whole.seconds + 1e-5))))
            assert np.geterr() == around, told
        assert solve(problem, name).z.tobytes() == whole.z.tobytes(), name
        print(name, *told)
    print("finished")
"""


@pytest.mark.full
def test_ctrl_c_at_any_moment_leaves_everything_whole():
    """SIGINT at random moments gives INTERRUPTED with a point of the box, or SOLVED; the next run has the same bits."""
    code = f"import sys\nsys.argv[1:] = {['npsor', 'psor', 'mgs', 'multigrid', 'newton', 'interior_point', 'auto']!r}\n"
    done = in_a_process(code + textwrap.dedent(INTERRUPTIONS))
    assert done.stdout.splitlines()[-1:] == ["finished"], done.stdout + done.stderr
    assert done.stdout.count("INTERRUPTED") >= 5, done.stdout


COMPILED_IN_TWO_THREADS = """
    from concurrent.futures import ThreadPoolExecutor
    import numpy as np
    from lcp_plugin.core.kernels.compilation import kernel
    def added(x): return x.size + x.sum()
    def subtracted(x): return x.size - x.sum()
    with ThreadPoolExecutor(2) as pool:
        print(*pool.map(lambda of: kernel(of)(np.ones(3)), [added, subtracted]))
"""


@pytest.mark.full
def test_two_threads_may_be_the_first_that_compile(tmp_path):
    """In a process without cached code, two threads set up numba's tables once."""
    done = in_a_process(COMPILED_IN_TWO_THREADS, NUMBA_CACHE_DIR=str(tmp_path))
    assert done.stdout.split() == ["6.0", "0.0"], done.stderr


# --- NaN in one method of a chain -----------------------------------------------------------------------------------


@pytest.mark.parametrize("fault", [np.nan, np.inf, -1e300])
def test_a_method_of_the_chain_that_breaks_is_replaced(fault, monkeypatch):
    """If the first method of auto yields NaN, ∞ or wrong points, another method takes over."""
    healthy = NPSOR.iterates

    def broken(self, problem, z0):
        for k, step in enumerate(healthy(self, problem, z0)):
            if k == 3:
                break
            yield step
        while True:
            yield Step(np.full(problem.n, fault))

    problem = membranes.build("random_h_plus", n=400).problem
    monkeypatch.setattr(NPSOR, "iterates", broken)
    result = solve(problem)
    assert result.status is Status.SOLVED
    assert len(result.stages) > 1
    monkeypatch.undo()
    np.testing.assert_allclose(result.z, solve(problem, "lemke").z, atol=1e-6)


def test_an_error_in_the_middle_of_an_algorithm_is_passed_on(monkeypatch):
    """An unexpected exception propagates: auto does not hide it behind another method."""

    def broken(self, problem, z0):
        yield Step(z0)
        raise ZeroDivisionError("a bug")

    monkeypatch.setattr(NPSOR, "iterates", broken)
    with pytest.raises(ZeroDivisionError):
        solve(SWEPT)


# --- Memory, disk, folders ------------------------------------------------------------------------------------------

MEMORY = """
    import resource
    from pathlib import Path
    import numpy as np
    import scipy.linalg, scipy.optimize, scipy.sparse.linalg
    from lcp_plugin import LCP, LCPError, solve
    from lcp_plugin import gallery
    A = np.eye(300) + 1.0  # BLAS takes its buffers at its first call, and ends the process where it gets none
    scipy.linalg.lu_factor(A @ A)
    def used():
        return int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    def limited(name, problem, spare):
        limit = used() + spare * 2**20
        resource.setrlimit(resource.RLIMIT_AS, (limit, resource.RLIM_INFINITY))
        try:
            result = solve(problem, name, max_iterations=30)
            assert result.is_solved == (result.residual <= result.tolerance)
            return result.status.name
        except MemoryError:
            return "MemoryError"
        except LCPError as error:
            return type(error).__name__
        finally:
            resource.setrlimit(resource.RLIMIT_AS, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
    sizes = {"npsor": 200, "newton": 150, "multigrid": 300, "interior_point": 50, "lemke": 16, "auto": 200}
    for name, size in sizes.items():
        scene = gallery.build("obstacle_2d", size=size, shifted=True).problem
        solve(LCP(scene.csr, scene.q, lower=scene.lower), name, max_iterations=30)  # compile and load: LLVM would abort
        told = [limited(name, LCP(scene.csr, scene.q, lower=scene.lower), spare) for spare in (0, 1, 4, 16)]
        told.append(limited(name, scene, 2))
        whole = solve(scene, name, max_iterations=30)  # with whatever the run without memory has left behind
        other = solve(LCP(scene.csr.copy(), scene.q, lower=scene.lower), name, max_iterations=30)
        assert whole.z.tobytes() == other.z.tobytes(), name
        print(name, *told)
    print("finished")
"""


@pytest.mark.full
@pytest.mark.skipif(
    not sys.platform.startswith("linux"), reason="address space limits are a thing of Linux"
)
def test_a_lack_of_memory_is_an_error():
    """Under a memory limit a run ends with MemoryError, an LCPError or a result; others work."""
    for _ in range(3):  # SuperLU without memory sometimes ends by a signal
        done = in_a_process(MEMORY, MALLOC_MMAP_THRESHOLD_="65536")
        if done.returncode >= 0:
            break
    # because SuperLU may print later
    assert "finished" in done.stdout.splitlines(), done.stdout + done.stderr
    assert "MemoryError" in done.stdout


COMPILE = """
    from lcp_plugin import LCP, solve
    from lcp_plugin.core.kernels import splitting_sweeps as kernels
    print(kernels.__file__)
    problem = LCP([[2, 1], [1, 2]], [-5, 1])
    from lcp_plugin.core.sweep_data import split_matrix
    print(*split_matrix(problem.matrix, False)[1])
"""
SOLVE = COMPILE + "    print(solve(problem, 'npsor').z)"


@pytest.fixture(scope="module")
def read_only_package(tmp_path_factory):
    """Return a copy of the package in which nothing can be cached: its cache folders are files."""
    folder = tmp_path_factory.mktemp("copy")
    copytree(PACKAGE, folder / "lcp_plugin", ignore=ignore_patterns("__pycache__"))
    for package in [
        folder / "lcp_plugin",
        *(path for path in (folder / "lcp_plugin").rglob("*") if path.is_dir()),
    ]:
        (package / "__pycache__").write_text("")
    return folder


@pytest.mark.full
@pytest.mark.parametrize("cache", ["unwritable", "full disk"])
def test_compiled_code_needs_no_place_on_disk(cache, read_only_package, tmp_path):
    """If compiled code cannot be stored, or the disk is full, the kernels nevertheless work."""
    blocked = tmp_path / "file"
    blocked.write_text("")
    environment = {
        "PYTHONPATH": str(read_only_package),
        "PYTHONDONTWRITEBYTECODE": "1",
        "HOME": str(blocked),
    }
    environment |= {"XDG_CACHE_HOME": str(blocked / "cache")}
    if cache == "full disk":
        environment["NUMBA_CACHE_DIR"] = str(tmp_path / "cache")
        limit = "import resource\nresource.setrlimit(resource.RLIMIT_FSIZE, (64, resource.RLIM_INFINITY))\n"
        done = in_a_process(limit + textwrap.dedent(SOLVE), **environment)
    else:
        done = in_a_process(COMPILE, **environment, NUMBA_CACHE_DIR=str(blocked / "cache"))
    assert done.returncode == 0, done.stderr
    where, splits, *z = done.stdout.splitlines()
    assert Path(where).is_relative_to(read_only_package)
    assert splits == "0 3"
    assert z == (["[2.5 0. ]"] if cache == "full disk" else [])
