"""Published and analytic solutions, and errors against them."""
