"""The weak form: the model's residual averaged with test functions; no signal is differentiated."""
