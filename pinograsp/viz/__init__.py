"""Figures and viewer of a run."""
