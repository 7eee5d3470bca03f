"""What a vehicle is: symbols, effects and units. Nothing here imports numpy or casadi."""
