"""From landmarks on the first frame to the model and the first state, section 3.1 of the paper."""
