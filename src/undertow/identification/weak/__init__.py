"""The weak form: the residual of the model averaged with test functions, without differentiating any signal."""
