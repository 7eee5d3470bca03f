"""The command line: one module per command.

A file in this folder whose name does not start with ``_`` is a command (``main.py`` apart, the entry point).
"""
