"""What each mechanism of the package buys: it is replaced from outside, and the same problems are solved beside it.

``python tests/ablation [NAME …] [--pairs]`` measures, and writes ``ablation.md``. A new mechanism is a row of
``mechanisms.py``; one that loses nothing goes.
"""
