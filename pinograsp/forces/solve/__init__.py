"""Programs of the forces, the solvers that answer them, and what they answer."""
