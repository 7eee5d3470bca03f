"""Commands about vehicles and what they are made of."""
