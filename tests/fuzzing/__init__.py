"""Hostile inputs by the thousand: one module for each kind of input, and the harness that runs them."""
