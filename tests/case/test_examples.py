"""The cases that come with the package, and their copies."""

import pytest

from isphcli.case.examples import ExampleError, copy_example, described_examples, example_file, example_files
from isphcli.case.load import load_case

from ..paths import CASES


def test_all_cases_are_examples_with_a_title():
    assert [path.name for path in example_files()] == sorted(path.name for path in CASES.glob("*.yaml"))
    assert all(title for _, title in described_examples())


@pytest.mark.parametrize("name, count", [("slit", 1), ("berea", 2), ("bead_pack.yaml", 2)])
def test_a_copy_is_complete(name, count, tmp_path):
    written = copy_example(name, tmp_path / "new")
    assert len(written) == count and load_case(written[0]).title == load_case(example_file(name)).title
    assert sorted(path for path in (tmp_path / "new").rglob("*") if path.is_file()) == sorted(written)


def test_files_of_others_are_not_replaced(tmp_path):
    copy_example("berea", tmp_path)
    copy_example("berea", tmp_path)  # the same files
    (tmp_path / "data/berea_128.npz").write_bytes(b"mine")
    (tmp_path / "berea.yaml").unlink()
    with pytest.raises(ExampleError, match="is there already"):
        copy_example("berea", tmp_path)
    assert not (tmp_path / "berea.yaml").exists() and (tmp_path / "data/berea_128.npz").read_bytes() == b"mine"


def test_a_name_that_is_none():
    with pytest.raises(ExampleError, match="did you mean 'berea'"):
        example_file("brea")
    with pytest.raises(ExampleError, match="lists all"):
        example_file("qqqq")
