"""What the parameters of a reference may be."""

from isphcli.case.blocks import REFERENCE_KINDS
from isphcli.references.parameters import OF_TWO_FLUIDS, PARAMETERS, needed, words


def test_every_kind_says_what_it_needs_and_which_of_it_are_words():
    assert set(OF_TWO_FLUIDS) < set(PARAMETERS) == set(REFERENCE_KINDS)
    assert needed("imbibition") == ["width", "length", "start"] and needed("static_drop") == []
    assert words("imbibition", "start", ("a", "b"), ("x_min",)) is None  # a length
    assert words("oscillating_slit", "start", ("a", "b"), ("x_min",)) == ("rest", "periodic")
    assert words("static_drop", "drop", ("a", "b"), ("x_min",)) == ("a", "b")
    assert words("contact_angle", "wall", ("a", "b"), ("x_min",)) == ("x_min",)
