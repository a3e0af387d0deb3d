"""Reading MATLAB's .mat files, versions 4 to 7.2, by scipy.

scipy's reader may end the process on a damaged file: read files that you trust.
"""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path
from typing import Any

import numpy as np
import scipy.sparse as sp

from ...core.errors import UnreadableFile

WHOLE = (f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64))
NUMBERS = {"sparse", "double", "single", "logical", *WHOLE}
WORDS = {"char": "text", "cell": "a cell array", "struct": "a struct", "object": "an object", "function": "a function"}


def read_mat(source: Path, wanted: Collection[str]) -> tuple[dict[str, Any], list[str]]:
    """Return those of the wanted matrices that the file holds, 2-D ndarrays or CSC arrays, and all names in it.

    Whatever else has another name is passed over unread, and nothing is executed.

    Raises
    ------
    UnreadableFile
        Where the file is missing, damaged, of another version, or a wanted name is no real matrix.
    """
    from scipy.io import loadmat, whosmat

    try:
        with source.open("rb") as file:
            kinds = {name: kind for name, _, kind in whosmat(file) if not name.startswith("__")}
        if other := next((name for name in wanted if kinds.get(name, "double") not in NUMBERS), None):
            what = WORDS.get(kinds[other], "no array")
            raise UnreadableFile(f"cannot read {source}: {other} is {what}; save a matrix of numbers")
        names = [name for name in kinds if name in wanted]
        with source.open("rb") as file:
            found = loadmat(file, variable_names=names) if names else {}
    except UnreadableFile:
        raise
    except FileNotFoundError as error:
        raise UnreadableFile(f"no such file: {source}") from error
    except NotImplementedError as error:
        raise UnreadableFile(
            f'cannot read {source}: it is of version 7.3 (HDF5); in MATLAB write save("{source.name}", "M", "q", "-v7")'
        ) from error
    except Exception as error:  # a damaged file raises whatever its decoders raise
        raise UnreadableFile(f"cannot read {source}: it is damaged or no .mat file of numbers ({error})") from error
    return {name: _checked(found[name], name, source) for name in names}, list(kinds)


def _checked(matrix: Any, name: str, source: Path) -> Any:
    if np.iscomplexobj(matrix):
        raise UnreadableFile(f"cannot read {source}: {name} is complex; save real numbers")
    if len(matrix.shape) != 2:
        raise UnreadableFile(f"cannot read {source}: {name} has the shape {matrix.shape}; save a matrix or a vector")
    if not sp.issparse(matrix):
        return matrix.astype(matrix.dtype.newbyteorder("="))
    try:
        columns = sp.csc_array(matrix)
        columns.check_format(full_check=True)
        return columns
    except (ValueError, IndexError, OverflowError) as error:
        raise UnreadableFile(f"cannot read {source}: {name} is no sparse matrix ({error}); write it again") from error
