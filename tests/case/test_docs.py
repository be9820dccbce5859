"""The documents of keys: every key is in them, and the schema is that of the reader."""

import json

import jsonschema
import yaml

from isphcli.case import docs as case_docs
from isphcli.case.load import dump_case
from tests.case.texts import BEADS, MINIMAL, SHAPES, read


def test_every_key_is_documented_and_the_generated_files_are_fresh():
    for path, text in case_docs.generated().items():
        assert path.read_text(encoding="utf-8") == text, f"{path}: run python -m isphcli.case.docs"


def test_schema_accepts_what_the_reader_accepts_and_refuses_typos():
    validator = jsonschema.Draft202012Validator(case_docs.schema())
    validator.check_schema(case_docs.schema())
    for text in (BEADS, SHAPES, MINIMAL):
        validator.validate(json.loads(json.dumps(_numbers(yaml.safe_load(dump_case(read(text)))))))
        validator.validate(_numbers(yaml.safe_load(text)))
    for bad in ("particles.spacin=1", "particles.spacing=-1", "drive.axes=[w]", "geometry.voxels.file=a"):
        tree = yaml.safe_load(MINIMAL)
        name, value = bad.split("=")
        *above, last = name.split(".")
        block = tree
        for part in above:
            block = block.setdefault(part, {})
        block[last] = yaml.safe_load(value)
        assert not validator.is_valid(tree), bad


def _numbers(tree):
    """What an editor's YAML 1.2 parser makes of `1e-5`, which PyYAML leaves as text."""
    if isinstance(tree, dict):
        return {k: _numbers(v) for k, v in tree.items()}
    if isinstance(tree, list):
        return [_numbers(v) for v in tree]
    try:
        return float(tree) if isinstance(tree, str) else tree
    except ValueError:
        return tree
