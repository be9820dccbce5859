"""A run of a case in a process of its own: prints the CPU seconds of the operating system and those that it reports.

usage: python benchmarks/measured_run.py CASE.yaml [key=value ...]

For measuring.py and a test of what `summary.json` reports: one line of JSON, [seconds, {section: seconds}].
"""

import json
import resource
import sys

from isphcli.case.load import load_case
from isphcli.runs.run import run_case


def used():
    spent = resource.getrusage(resource.RUSAGE_SELF)
    return spent.ru_utime + spent.ru_stime


if __name__ == "__main__":
    case = load_case(sys.argv[1], sys.argv[2:])
    before = used()
    summary = run_case(case, quiet=True)
    print(json.dumps([used() - before, summary["cpu_seconds"]]))
