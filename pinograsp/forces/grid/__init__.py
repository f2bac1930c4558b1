"""The paper's grid over the unknowns, and the global optimum."""
