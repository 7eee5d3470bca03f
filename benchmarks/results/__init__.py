"""What undertow makes of data that it was not built on: the tables and pictures of docs/results.md."""
