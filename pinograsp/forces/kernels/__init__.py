"""All compiled code (extra ``fast``): two solvers for grasp forces, the checks of their answers, and the loops around
them.

From the bottom up: :mod:`~pinograsp.forces.kernels.layouts` names what goes in and out, and needs no numba; `powers`,
`algebra`, `limits`, `cones` and `rows` are parts; `dual` and `newton` are the dual Newton method, `interior`, `steps`
and `bounds` the interior-point method; `single`, `bulk`, `tick` (with `torques`) and `boxes` are what Python calls, and
`packing` and `memory` are how it hands over what costs too much as many arrays.

A function's code contains that of the functions that it calls, and the constants that it reads. Numba's cache on disk
looks only at a function's own file, so :mod:`pinograsp.forces.jit` has it look at all files of the folder; these
therefore take functions and constants from each other alone.
"""
