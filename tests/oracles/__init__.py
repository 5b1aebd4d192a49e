"""Slow twins of what the package computes."""
