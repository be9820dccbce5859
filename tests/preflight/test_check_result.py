"""The check as it is printed."""

import dataclasses

from isphcli.preflight.check import check
from tests.preflight.cases import DROP, read


def test_the_text_has_all_of_it():
    found = check(read(DROP))
    text = found.text()
    for term in found.physics:
        assert term.name in text
    for word in ("particles", "porosity", "throats", "Re ", "Ca ", "capillary", "memory", "time", "verdict"):
        assert word in text
    assert dataclasses.asdict(found)["dim"] == 2
