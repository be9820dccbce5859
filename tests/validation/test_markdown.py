"""Markdown of reports."""

from isphcli.validation.markdown import items, origin, table


def test_a_table_keeps_a_row_on_a_line():
    """What would end a cell or a row is written so that it does not."""
    assert table(["a", "b"], [["x | y", "first\n  second"]]) == ["| a | b |", "| --- | --- |",
                                                                 "| x \\| y | first second |"]


def test_a_list():
    assert items(["one", "two"]) == ["- one", "- two"]


def test_where_a_report_comes_from(monkeypatch):
    monkeypatch.setattr("sys.argv", ["/usr/bin/isph", "validate", "a case.yaml"])
    found = origin()
    assert found["command"] == "isph validate 'a case.yaml'" and "isphcli" in found["versions"]
    assert found["date"].endswith("+00:00")
