"""Linear solvers and preconditioners (paper eqs 25-26).

The projection P of eq. 26 itself is `ComponentMeans` of `domain/null_space.py`.
"""
