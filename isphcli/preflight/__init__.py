"""The check of a case before it runs: the terms it uses, memory, time and warnings."""
