"""Commands about controllers and linear models."""
