"""The command line: one module per command, in a folder for what it is about.

A file in this folder or in one below it whose name does not start with ``_`` is a command (``main.py`` apart,
the entry point).
"""
