"""What is asked: the language of case files, and the one reading of what drives the flow."""
