"""The posterior and its optimisation, section 3.2 of the paper; `realtime` is the preset that goes on from there."""
