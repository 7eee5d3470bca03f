"""How useful the answers on real logs are: terms taken out, effects injected exactly, and predictions."""
