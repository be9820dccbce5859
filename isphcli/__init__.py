"""isphcli: flow through rock and other complex solids by consistent implicit incompressible SPH."""

__version__ = "0.1.0"

COMPLETE = ("finished", "steady")  # status of a run that has what was asked for
