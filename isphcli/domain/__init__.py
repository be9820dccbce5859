"""Points, ghosts, neighbours, and sums over all particles."""
