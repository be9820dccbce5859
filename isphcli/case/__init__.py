"""The language of case files, its checks, and the one reading of what drives the flow."""
