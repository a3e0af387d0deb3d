"""The ten lines at the head of an ``.nl`` file, text in binary files too."""

from __future__ import annotations

from dataclasses import dataclass

from .segments import HeadFault

LINES = 10
MOST_OPTIONS = 9
WITH_TOLERANCE = 3  # as the second option: the first line ends with a tolerance
LITTLE_ENDIAN, BIG_ENDIAN = 1, 2  # the kinds of arithmetic that can be read; 0 is the writer's own
MOST_LINE_BYTES = 4096  # a line of the header is never longer

NEEDED = {  # line: (numbers that must stand there, numbers that may)
    2: (3, 6), 3: (2, 6), 4: (2, 2), 5: (2, 3), 6: (2, 4), 7: (2, 5), 8: (2, 2), 9: (2, 2), 10: (5, 5),
}
MEANING = {
    2: "variables, rows, objectives", 3: "nonlinear rows and objectives", 4: "network rows", 5: "nonlinear variables",
    6: "network variables, functions", 7: "integer variables", 8: "nonzeros", 9: "lengths of names",
    10: "defined variables",
}


@dataclass(frozen=True)
class Header:
    """The numbers of the head; the names are of what is used of them."""

    is_binary: bool
    options: tuple[int, ...]
    tolerance: float | None
    variables: int
    rows: int
    objectives: int
    logical_rows: int
    complementarities: int
    nonlinear: tuple[int, int, int]  # variables in rows, in objectives, in both
    functions: int
    arithmetic: int
    integers: tuple[int, int, int, int, int]  # binary, integer; nonlinear in both, in rows, in objectives
    nonzeros: int
    objective_nonzeros: int
    name_lengths: tuple[int, int]
    defined: int

    @property
    def byteorder(self) -> str:
        """As struct writes it."""
        return ">" if self.arithmetic == BIG_ENDIAN else "<"


def read_header(data: bytes) -> tuple[Header, int]:
    """Return the head and where the segments begin."""
    lines, position = [], 0
    for number in range(1, LINES + 1):
        end = data.find(b"\n", position, position + MOST_LINE_BYTES)
        if end < 0:
            raise HeadFault(number, f"the head of an .nl file has {LINES} lines, and the file ends here"
                            if len(data) - position < MOST_LINE_BYTES else "this is no line of the head of an .nl file")
        lines.append(data[position:end])
        position = end + 1
        if number == 1 and lines[0][:1] not in (b"g", b"b"):
            raise HeadFault(1, "an .nl file begins with g (text) or b (binary)")
    is_binary = lines[0][:1] == b"b"
    options, tolerance = _options(lines[0][1:])
    numbers = {k: _numbers(lines[k - 1], k) for k in NEEDED}
    _refuse_what_cannot_follow(numbers, len(data) - position)
    size, complementarity, integers = numbers[2], numbers[3], numbers[7]
    arithmetic = numbers[6][2]
    if is_binary and arithmetic not in (0, LITTLE_ENDIAN, BIG_ENDIAN):
        raise HeadFault(6, f"its numbers are of the arithmetic {arithmetic}, and 1 (IEEE, little-endian) "
                        "or 2 (big-endian) is needed; write the file as text")
    return Header(
        is_binary=is_binary, options=options, tolerance=tolerance, variables=size[0], rows=size[1],
        objectives=size[2], logical_rows=size[5], complementarities=complementarity[2] + complementarity[3],
        nonlinear=(numbers[5][0], numbers[5][1], numbers[5][2]), functions=numbers[6][1], arithmetic=arithmetic,
        integers=(integers[0], integers[1], integers[2], integers[3], integers[4]), nonzeros=numbers[8][0],
        objective_nonzeros=numbers[8][1], name_lengths=(numbers[9][0], numbers[9][1]), defined=sum(numbers[10]),
    ), position


def _options(text: bytes) -> tuple[tuple[int, ...], float | None]:
    """Return the numbers of the first line, the first of which says how many follow, and the tolerance."""
    words = text.split(b"#")[0].split()
    try:
        count = int(words[0]) if words else 0
        if not 0 <= count <= MOST_OPTIONS:
            raise HeadFault(1, f"it announces {count} options, and at most {MOST_OPTIONS} are possible")
        given = [int(word) for word in words[1:count + 1]]
        options = (count, *given, *[0] * (count - len(given)))
        has_tolerance = count >= 2 and options[2] == WITH_TOLERANCE and len(words) > count + 1
        return options, float(words[count + 1]) if has_tolerance else None
    except ValueError as error:
        if isinstance(error, HeadFault):
            raise
        raise HeadFault(1, "the options behind its letter are whole numbers") from None


def _numbers(line: bytes, number: int) -> list[int]:
    """Return the numbers of a line, zeros for those that may be missing."""
    needed, possible = NEEDED[number]
    words = line.split(b"#")[0].split()
    if len(words) < needed or not all(word.isdigit() for word in words[:possible]):
        count = needed if needed == possible else f"{needed} to {possible}"
        raise HeadFault(number, f"{count} whole numbers are needed ({MEANING[number]})")
    if max(map(len, words[:possible])) > 18:
        raise HeadFault(number, "that is more than any file can hold")
    return [int(word) for word in words[:possible]] + [0] * (possible - len(words))


def _refuse_what_cannot_follow(numbers: dict[int, list[int]], length: int) -> None:
    """Raise where more is announced than so many bytes can hold, at one byte each, before anything is allocated."""
    for k, which in ((2, (0, 1, 2, 5)), (6, (1,)), (8, (0, 1)), (10, (0, 1, 2, 3, 4))):
        for position in which:
            if numbers[k][position] > length:
                raise HeadFault(k, f"{numbers[k][position]} are announced ({MEANING[k]}), and {length} bytes follow")

