"""Sparse matrices of pair weights."""

import numpy as np
import scipy.sparse as sp


def assemble(start: np.ndarray, column: np.ndarray, weights: np.ndarray, shift: float | np.ndarray, scale: float,
             diagonal: np.ndarray | None = None) -> sp.csr_matrix:
    """The matrix  shift - scale * L  in canonical CSR form, L f_i = sum_j w_ij (f_j - f_i) - diagonal_i f_i.

    weights: (n_pairs,); shift: a number or (n,); scale: a number; diagonal: (n,) wall sums or None.
    """
    n = len(start) - 1
    total = row_sums(start, weights)
    if diagonal is not None:
        total = total + diagonal
    # scipy sorts in place: it must not reorder the columns that the operators hold
    matrix = sp.csr_matrix((-scale * weights, column.copy(), start.copy()), shape=(n, n))
    matrix = matrix + sp.diags_array(shift + scale * total).tocsr()
    matrix.sum_duplicates()
    if max(matrix.nnz, n) < 2**31:
        matrix.indptr, matrix.indices = matrix.indptr.astype(np.int32), matrix.indices.astype(np.int32)
    return matrix


def row_sums(start: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Sums of the entries of each row, (n,); empty rows give zero."""
    total = np.concatenate([[0.0], np.cumsum(values)])
    return total[start[1:]] - total[start[:-1]]
