"""Two suites from one set of tests.

    python -m pytest -n 2           every test that is not marked ``full``
    python -m pytest --full -n 2    everything

The mark ``full`` is for tests that take seconds: benchmarks, campaigns, examples. The rows of a parametrized test are
a table. Without ``--full``

- all rows of a table run, unless
- its test has ``@pytest.mark.quick(n)``: n of its rows, of which the first is one, spread over the table, and
- each row with ``pytest.param(…, marks=pytest.mark.quick)``: the row of a repaired fault in such a table.

A test that draws its problems from a campaign has the fixture ``draws``: an eighth of them without ``--full``. A test
that is named on the command line, as in ``tests/methods/newton/test_newton.py::test_x``, always runs.

Hypothesis: examples are the same in each run, so that a suite that passed passes again; random draws are for
``tests/campaigns``. A test without settings takes the default; a costly one says ``@settings.get_profile("few")``, a
cheap one that needs rare draws ``"many"``.

BLAS gets one thread if the environment names no number: several processes of several threads wait for one another.
"""

from __future__ import annotations

import gc
import os
import signal
import subprocess
import sys
from collections import defaultdict
from collections.abc import Iterator
from contextlib import nullcontext
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, settings

# read when numpy is loaded; processes that tests begin inherit it
os.environ.setdefault("OMP_NUM_THREADS", "1")

# profile: examples in the quick suite, in the full one
EXAMPLES = {"few": (3, 30), "default": (6, 80), "many": (12, 150)}
# Folders with tests of functions that are not public; core/test_floating_point_state.py calls those that are.
INNER = {"core", "engines", "methods", "problems", "proofs", "systems"}
# Doctests of seconds; tests/interfaces and tests/strategies have short ones of the same.
SLOW = ("lcp_plugin.interfaces", "lcp_plugin.strategies.assert_solves")
WARM_UP = pytest.StashKey["subprocess.Popen[bytes]"]()


def pytest_addoption(parser: pytest.Parser) -> None:
    """Offer --full."""
    parser.addoption("--full", action="store_true", help="run every test, with more examples each")


def pytest_configure(config: pytest.Config) -> None:
    """Deselect ``full`` unless asked, set how many examples are drawn, and let Ctrl-C arrive, which tests send."""
    if not (config.getoption("--full") or any("::" in argument for argument in config.args)):
        config.option.markexpr = config.option.markexpr or "not full"
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # begun in the background
        signal.signal(signal.SIGINT, signal.default_int_handler)
    for name, numbers in EXAMPLES.items():
        count = numbers[bool(config.getoption("--full"))]
        settings.register_profile(
            name, max_examples=count, derandomize=True, database=None,
            # Neither clocks nor a busy machine decide; examples that share a tmp_path write all that they read.
            deadline=None, suppress_health_check=[HealthCheck.too_slow, HealthCheck.function_scoped_fixture],
        )  # fmt: skip
    settings.load_profile("default")


@pytest.fixture(autouse=True)
def floating_point_state(request):
    """Set the state of numpy that the public functions set, for tests of the functions inside them."""
    folder = request.path.relative_to(request.config.rootpath).parts[1]
    with np.errstate(all="ignore") if folder in INNER else nullcontext():
        yield


@pytest.fixture
def double_precision():
    """Let JAX have double precision in a test; it stands here because doctests let one more file have this name."""
    jax = pytest.importorskip("jax")
    before = jax.config.jax_enable_x64
    jax.config.update("jax_enable_x64", True)
    yield
    jax.config.update("jax_enable_x64", before)


@pytest.fixture
def draws(pytestconfig):
    """So many problems of a campaign are drawn in the full suite, an eighth (a part) of them in the quick one."""
    is_full = bool(pytestconfig.getoption("--full"))
    return lambda count, part=8: range(count if is_full else count // part)


def pytest_runtest_teardown() -> None:
    """Close the figures of a test: the number of open figures must not depend on the tests before."""
    if "matplotlib.pyplot" in sys.modules:
        sys.modules["matplotlib.pyplot"].close("all")


@pytest.hookimpl(tryfirst=True)
def pytest_sessionstart(session: pytest.Session) -> None:
    """Let the command compile what is not compiled yet while workers collect a whole suite."""
    config = session.config
    has_workers = config.getoption("numprocesses", None) and not hasattr(config, "workerinput")
    if has_workers and not config.getoption("file_or_dir"):
        print("kernels are compiled where none are kept", flush=True)
        config.stash[WARM_UP] = subprocess.Popen(
            [sys.executable, "-m", "lcp_plugin", "warm-up"], stdout=subprocess.DEVNULL
        )


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_node_collection_finished(node: Any) -> None:
    """Let no worker begin before kernels are compiled: each would, by itself."""
    if WARM_UP in node.config.stash:
        node.config.stash[WARM_UP].wait()


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """Give each worker files that lie side by side, which share what they load; who is done early takes from others."""
    from xdist.scheduler import WorkStealingScheduling

    return WorkStealingScheduling(config, log) if config.getoption("dist") == "load" else None


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Iterator[None]:
    """Look for no garbage while tests are collected, which takes a quarter of the time, and rarely after."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.set_threshold(10_000)
        gc.enable()


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark the rows of a table ``full`` that its mark leaves out."""
    tables = defaultdict(list)
    for item in items:
        if item.name in SLOW:
            item.add_marker("full")
        if not item.get_closest_marker("full"):
            tables[item.nodeid.partition("[")[0]].append(item)
    for rows in tables.values():
        numbers = [mark.args[0] for mark in rows[0].iter_markers("quick") if mark.args]
        spread = sorted(
            range(len(rows)), key=lambda k: k * 0.618 % 1.0
        )  # steps of the golden section
        for k in spread[numbers[0] :] if numbers else ():
            if all(mark.args for mark in rows[k].iter_markers("quick")):
                rows[k].add_marker("full")
