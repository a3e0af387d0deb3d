"""Write the manual: ``python tests/manual FOLDER``; then open FOLDER/index.html, for which no network is needed.

Pictures and outputs that FOLDER does not hold yet are made by running the examples, which takes a minute or two.
``--keep`` puts those that pages of ``examples/manual`` show into ``examples/pictures``, made small, and writes the
notebooks of ``examples/notebooks``.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

sys.path[0] = str(Path(__file__).parents[1])
sys.path.insert(1, str(Path(__file__).parents[2]))

from manual.notebooks import keep_notebooks  # noqa: E402
from manual.pictures import keep  # noqa: E402
from manual.site import run_examples, write  # noqa: E402

if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        "python tests/manual", description=(__doc__ or "").partition("\n")[0]
    )
    parser.add_argument("folder", type=Path, help="where the pages go")
    parser.add_argument(
        "--keep", action="store_true", help="write the pages' pictures and the notebooks, too"
    )
    given = parser.parse_args()
    folder = given.folder
    for line in run_examples(folder):
        print(line, flush=True)
    for line in (*keep(folder), *keep_notebooks()) if given.keep else ():
        print(line, flush=True)
    print(f"{write(folder)} pages; open {folder / 'index.html'}")
