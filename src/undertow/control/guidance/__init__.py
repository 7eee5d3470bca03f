"""Missions: references over time, and guidance along straight legs."""
