"""Hansen's economy, as published: its goods, consumers and activities."""

from __future__ import annotations

import numpy as np

# Scarf, Hansen, The Computation of Economic Equilibria, Yale 1973: an economy of 14 goods, 4 consumers, 26 activities.
GOODS = (
    "agric",
    "food",
    "textiles",
    "hserv",
    "entert",
    "houseop",
    "capeop",
    "steel",
    "coal",
    "lumber",
    "housbop",
    "capbop",
    "labor",
    "exchange",
)
OWNED = {"housbop": (2, 0.4, 0, 0.8), "capbop": (3, 2, 0, 7.5), "labor": (0.6, 0.8, 1, 0.6)}
WANTED = {
    "agric": (0.1, 0.2, 0.3, 0.1),
    "food": (0.2, 0.2, 0.2, 0.2),
    "textiles": (0.1, 0.1, 0.3, 0.1),
    "hserv": (0.1, 0.1, 0.1, 0.1),
    "entert": (0.1, 0.1, 0.1, 0.1),
    "houseop": (0.3, 0.1, 0, 0.1),
    "capeop": (0.1, 0.2, 0, 0.3),
}
# One activity a line: what it makes, what it takes.
ACTIVITIES = """
agric 5 capeop .4 | food .9 textiles .2 hserv 1 steel .2 coal 1 lumber .5 capbop .5 labor .4
food 5 capeop 1.3 | agric 3.5 textiles .5 hserv 2 steel .4 coal .1 lumber .4 capbop 1.5 labor .2
textiles 2 capeop 1.2 | agric .1 food .1 hserv 2 steel .2 coal .1 lumber .3 capbop 1.5 labor .2
hserv 2 houseop .32 | textiles .1 steel .1 coal 1 lumber .3 housbop .4 capbop .1 labor .02
entert 4 | agric .7 food .8 textiles .1 hserv 2 capbop .1 labor .4
houseop .8 capeop 1.1 | textiles .8 hserv .4 steel 1 lumber 3 capbop 1.5 labor .3
capeop 6 | textiles .4 hserv 1.8 steel 2 coal .2 lumber .2 capbop 2.5 labor .1
capeop 1.8 steel 2 | textiles .1 hserv 1.6 coal 1 lumber .2 capbop 2.5 labor .1
capeop 1.2 coal 2 | textiles .1 hserv .8 steel .5 lumber .5 capbop 1.5 labor .4
capeop .4 lumber 1 | textiles .1 hserv .2 steel .2 coal .2 capbop .5 labor .4
capeop .9 | capbop 1
houseop .36 | housbop .4
agric 1 | hserv .4 capbop .2 labor .04 exchange .5
food 1 | hserv .2 capbop .1 labor .02 exchange .4
textiles 1 | hserv .2 capbop .1 labor .02 exchange .8
capeop 1 | hserv .4 capbop .2 labor .04 exchange 1.2
steel 1 | hserv .4 capbop .2 labor .04 exchange .6
coal 1 | hserv .4 capbop .2 labor .04 exchange .7
lumber 1 | hserv .4 capbop .2 labor .04 exchange .4
exchange .5 | agric 1 hserv .2 capbop .2 labor .04
exchange .4 | food 1 hserv .2 capbop .1 labor .02
exchange .8 | textiles 1 hserv .2 capbop .1 labor .02
exchange 1.2 | hserv .4 capeop 1 capbop .2 labor .04
exchange .6 | hserv .4 steel 1 capbop .2 labor .04
exchange .7 | hserv .4 coal 1 capbop .2 labor .04
exchange .4 | hserv .4 lumber 1 capbop .2 labor .04
"""


def technique() -> np.ndarray:
    rows = ACTIVITIES.strip().splitlines()
    matrix = np.zeros((len(GOODS), len(rows)))
    for s, row in enumerate(rows):
        for words, sign in zip(row.split("|"), (1.0, -1.0), strict=True):
            pairs = words.split()
            for good, amount in zip(pairs[::2], pairs[1::2], strict=True):
                matrix[GOODS.index(good), s] += sign * float(amount)
    return matrix


def by_goods(table: dict[str, tuple[float, ...]]) -> np.ndarray:
    return np.array([table.get(good, (0, 0, 0, 0)) for good in GOODS], dtype=float)
