"""From a log to a controller that works, with an effect that the model lacked at first."""
