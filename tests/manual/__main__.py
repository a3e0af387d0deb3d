"""Write the manual: ``python tests/manual FOLDER``; then open FOLDER/index.html, for which no network is needed.

Pictures and outputs that FOLDER does not hold yet are made by running the examples, which takes a minute or two.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

sys.path[0] = str(Path(__file__).parents[1])
sys.path.insert(1, str(Path(__file__).parents[2]))

from manual.site import run_examples, write  # noqa: E402

if __name__ == "__main__":
    parser = argparse.ArgumentParser("python tests/manual", description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("folder", type=Path, help="where the pages go")
    folder = parser.parse_args().folder
    for line in run_examples(folder):
        print(line, flush=True)
    print(f"{write(folder)} pages; open {folder / 'index.html'}")
