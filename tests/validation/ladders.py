"""Cases of the repository by name."""

from isphcli.case.load import load_case
from tests.paths import CASES


def case(name, *overrides):
    return load_case(CASES / f"{name}.yaml", overrides)
