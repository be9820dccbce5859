"""Linear solvers and preconditioners (paper eqs 25-26)."""
