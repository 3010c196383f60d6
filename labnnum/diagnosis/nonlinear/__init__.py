"""Nonlinear physics: detected on lines that were not excited, located, named, and fitted by simulation."""
