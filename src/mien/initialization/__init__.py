"""From landmarks in the first frame to the face model and the initial state, section 3.1 of the paper."""
