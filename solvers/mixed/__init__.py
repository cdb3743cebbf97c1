"""Parts of the mixed variational method: cells, the converged rule, the alternating scheme."""
