"""Worked examples on real data: the pages of docs/examples, their numbers and their pictures."""
