"""Cases from files and back: what is dumped is read again as it was."""

import json
import pickle

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from isphcli.case.load import dump_case, load_case
from isphcli.case.yaml import CaseError
from tests.case.texts import BEADS, MINIMAL, SHAPES, read


@pytest.mark.parametrize("text", [BEADS, SHAPES, MINIMAL])
def test_dump_reads_back_to_an_equal_case(text, files):
    case = read(text)
    dumped = dump_case(case)
    elsewhere = files / "other" / "dir"
    elsewhere.mkdir(parents=True)
    (elsewhere / "effective.yaml").write_text(dumped)
    again = load_case(elsewhere / "effective.yaml")
    assert again == case
    assert hash(again) == hash(case)
    assert dump_case(again) == dumped
    assert pickle.loads(pickle.dumps(case)) == case
    assert "interface" not in yaml.safe_load(dump_case(read(MINIMAL)))


def test_the_case_of_a_grey_image_reads_back(files):
    """Its labels are dumped as an empty block, beside the grey values: a restart reads it."""
    case = read(BEADS.replace("labels: {solid: [1, 3], brine: 0, co2: 2}", "grey: {threshold: otsu, solid: above}"))
    assert case.geometry.voxels.grey is not None
    (files / "again.yaml").write_text(dump_case(case))
    assert load_case(files / "again.yaml") == case


@pytest.mark.parametrize("name", ["missing.yaml", ".", "nul\0"])
def test_a_case_that_cannot_be_read(name):
    with pytest.raises(CaseError, match="cannot be read"):
        load_case(name)


@given(st.text(max_size=30))
@settings(max_examples=30, deadline=None)
def test_any_title_survives_the_round_trip(title):
    try:
        case = read(MINIMAL, "title=" + json.dumps(title))
    except CaseError as error:
        assert "control characters" in str(error) or "not YAML" in str(error)
    else:
        assert read(dump_case(case)).title == case.title
