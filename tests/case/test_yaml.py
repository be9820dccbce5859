"""Texts that are no YAML, or none of a case: refused with the line, before memory or time is lost."""

import time

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from isphcli.case import yaml as case_yaml
from isphcli.case.load import dump_case, read_case
from isphcli.case.yaml import MAX_BYTES, MAX_DEPTH, CaseError
from tests.case.texts import BEADS, MINIMAL, SHAPES, problems, read


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("title: a\ntitle: b\n", "case.yaml:2: title: given twice, first in line 1; keep one of them"),
        ("a:\n - b: 1\n   b: 2\n", "case.yaml:3: a.0.b: given twice, first in line 2"),
        ("geometry:\n\tbox: [1, 1]\n", "case.yaml:2: not YAML: "),
        ("geometry: {box: [1, 1\n", "case.yaml:2: not YAML: "),
        ("a: &a 1\nb: *a\n", "case.yaml:2: aliases (*name) are not used in cases"),
        ("a: !!python/object:os.system 1\n", "case.yaml:1: tags (!name) are not used in cases"),
        ("a: 1\n---\nb: 1\n", "case.yaml:2: a second document; one case a file"),
        ("? [a]\n: 1\n", "case.yaml:1: a key must be a plain word"),
        ("- 1\n", "case.yaml:1: expected a block of keys, found a list"),
        ("", "case.yaml:1: geometry: missing; give where there is"),
        ("%TAG !e! tag:x\n---\na: 1\n", "case.yaml:1: directives (%) are not used in cases"),
        ("[" * 5000, "case.yaml:1: nested more than 32 deep"),
        ("a: {b: " * 5000, "case.yaml:1: nested more than 32 deep"),
        ("- " * 5000, "case.yaml:1: nested more than 32 deep"),
        ("? " * 5000, "case.yaml:1: nested more than 32 deep"),
        ("".join(" " * k + "a:\n" for k in range(1200)), "case.yaml:34: nested more than 32 deep"),
        ("a" * (MAX_BYTES + 1), "case.yaml: longer than 1000000 bytes; put long lists in a file"),
        ("a: [" + "1," * 200_000 + "]", "case.yaml:1: more than 100000 values; put long lists in a file"),
        ('a: "\\x07"', "case.yaml:1: control characters are not text; remove them"),
        ('a: "\\ud800"', "case.yaml:1: "),  # PyYAML refuses it where it has libyaml, else we do
    ],
)
def test_what_is_not_yaml_for_a_case(text, message):
    assert any(problem.startswith(message) for problem in problems(text))


NESTED = {
    "lists": lambda n: "[" * n + "]" * n,
    "blocks": lambda n: "{a: " * n + "1" + "}" * n,
    "lines": lambda n: "".join(" " * k + "a:\n" for k in range(n - 1)) + " " * (n - 1) + "a: 1",
    "items": lambda n: "- " * n + "1",
    "items below their key": lambda n: "".join(" " * k + ("a:\n", "-\n")[k % 2] for k in range(n)) + " " * n + "1",
}


@pytest.mark.parametrize("form", NESTED)
def test_the_depth_is_ours_before_yaml_sees_the_text(monkeypatch, form):
    """32 deep is read and 33 is not; 64 and more PyYAML is not even asked about, whose bounds change."""

    def depths(n):
        report = case_yaml.ProblemList()
        case_yaml.parse(NESTED[form](n), case_yaml.Where("a", 1), report)
        return [problem.message for problem in report.problems]

    assert depths(MAX_DEPTH) == [] and depths(MAX_DEPTH + 1) == ["nested more than 32 deep"]
    monkeypatch.setattr(yaml, "parse", lambda *_, **__: pytest.fail("PyYAML was asked"))
    for n in (2 * MAX_DEPTH, 1000, 1001, 100_000 if form in ("lists", "blocks", "items") else 1200):
        assert depths(n) == ["nested more than 32 deep"]


@pytest.mark.parametrize(
    ("written", "title"),
    [
        (f'"{"[" * 50}"', "[" * 50),
        (f"'it''s {'{' * 50}'", f"it's {'{' * 50}"),
        (f"a  # {'[' * 50}", "a"),
        (f'"a \\" {"[" * 50}"', f'a " {"[" * 50}'),
    ],
)
def test_brackets_in_texts_and_comments_do_not_nest(written, title):
    assert read(MINIMAL + f"title: {written}\n").title == title


def test_tabs_say_what_to_do():
    assert problems("geometry:\n\tbox: [1, 1]\n")[0].endswith("; indent with spaces, not tabs")


def test_bytes_that_are_not_text():
    with pytest.raises(CaseError, match=r"case\.yaml:2: not text; save it as UTF-8"):
        read_case(b"title: a\n\xff", "case.yaml")


def test_text_keeps_the_words_that_yaml_would_convert():
    assert read("title: no\n" + MINIMAL).title == "no"
    assert read("title: 'null'\n" + MINIMAL).title == "null"


@given(st.binary(max_size=60) | st.text("{}[]:-,#&*!|>'\"% \t\nab1.e~?@`\\", max_size=60).map(str.encode))
@settings(max_examples=100, deadline=None)
def test_any_bytes_are_a_case_or_a_case_error(data):
    with pytest.raises(CaseError):
        read_case(data, "case.yaml")


@given(st.data())
@settings(max_examples=100, deadline=None)
def test_a_damaged_case_is_a_case_or_a_case_error(data):
    text = data.draw(st.sampled_from([BEADS, SHAPES, MINIMAL]))
    start = data.draw(st.integers(0, len(text)))
    end = data.draw(st.integers(start, min(len(text), start + 20)))
    middle = data.draw(
        st.sampled_from(["", "null", "[]", "{}", "-1", "solid", "\n", ": ", "[1, 2]", "1e-400"])
    )
    try:
        case = read(text[:start] + middle + text[end:])
    except CaseError:
        return
    assert read(dump_case(case)) == case


def test_a_hostile_megabyte_is_refused_quickly():
    start = time.process_time()
    for text in (
        "a" * 999_999,
        "[" * 999_999,
        "{a: " * 249_999,
        "- " * 499_999,
        "".join(f"k{i}: 1\n" for i in range(40_000)),
    ):
        assert len(problems(text)) <= 100
    assert time.process_time() - start < 20  # measured 2 s
