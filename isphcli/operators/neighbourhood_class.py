"""How good the neighbourhood of a particle is, and what follows from it.

One tensor tells: the second moments of the neighbours in sight, sum w s e (x) e (`moments`), over the mean eigenvalue
that they have with those beyond walls. Its eigenvalues are shares: 1 where all neighbours are in sight, one half across
a flat wall, 0 in a direction that no neighbour in sight lies in. Beside a corner of a wide scene on its lattice the
smallest is 0.31 in 2D and 0.35 in 3D.

| class | of a particle | what it does |
|---|---|---|
| FULL | that sees all neighbours | nothing |
| WALL | that does not, smallest share NARROW_SHARE and more | pressure gradient and symmetric Laplacian over the fluid in sight (`wall_weights`); shifts are carried without second derivative |
| NARROW | smallest share below NARROW_SHARE: a corner, a pore about as narrow as a particle | as WALL; the divergence is minus the adjoint of the pressure gradient (`div_grad.adjoint_divergence`) |
| ISOLATED | largest share below THIN: a dead end beside points of contact; what only such particles join with the rest; a particle that sees nobody | as NARROW; it shares its pressure with nobody (`narrow_pores`), and no limit is set to its volume (`flow/step_limits.py`) |

In scenes with isolated particles, narrow ones may come nearer to walls (NEAR_WALL_NARROW of `flow/step.py`). In any
class, directions with a share below THIN are left out of the gradient: a pseudo-inverse (`moments.invert_gradient`).

Two rules do not go by this tensor: whether the tensor L of the velocity can be found. Velocities have values at walls,
so that its system (fourth moments over neighbours and crossing points) is whole where no fluid lies in a direction. Of
766 particles between beads that touch 386 have a share below 0.4, and only 29 of those have no L (the pack of
tests/operators/test_narrow_pores.py).

| rule | number | what it does |
|---|---|---|
| SINGULAR | smallest over largest pivot of the system of L (fourth moments) | L becomes a multiple of the identity, K zero |
| LOPSIDED | largest part of L beside a multiple of the identity, over that | the same |

Interfaces have no class: they fit quadratic functions, and what the neighbours do not determine of one is held at zero
by a small number on the diagonal of its moments, in `two_phase/quadratic_fit.py` always (RIDGE_...), in
`two_phase/two_fluids.py` where a pivot is below SINGULAR of their trace.

What was measured with other rules: docs/design_notes.md, pores that hardly hold particles.
"""  # noqa: E501

# Classes, the worse the larger
FULL, WALL, NARROW, ISOLATED = 0, 1, 2, 3
# Smallest share below which a pore is narrow: half-way between a corner (0.35 in 3D) and a flat wall (0.495)
NARROW_SHARE = 0.42
# The same of particles that stay on their lattice (steady flow): below a corner, whose consistent divergence is sound
# there; what is below it lies between two walls
NARROW_SHARE_FIXED = 0.3
# Share below which a direction is not known. With 1e-4 particles are thrown out from between beads that touch: a
# neighbourhood in a plane is inverted once a single neighbour, at the rim of the support, has moved a little out of it.
THIN = 0.05
ROUND = 0.2  # determinant over the cube of the mean share above which no share is below THIN, and none is computed
SINGULAR = 1e-7  # scaled pivot below which the system of L counts as rank-deficient
# L may differ from a multiple of the identity by this much of it; at 20 % jitter none does (Wendland C2)
LOPSIDED = 2.0
