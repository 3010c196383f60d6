"""Concealed suites: cases whose truth is sealed before the tool sees them, and the scoring of what it says."""
