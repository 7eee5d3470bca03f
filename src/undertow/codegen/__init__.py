"""From the symbolic model to CasADi functions, C source and compiled libraries."""
